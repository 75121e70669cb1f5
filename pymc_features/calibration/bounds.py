"""Parameters whose prior ends near to the likelihood's maximum: their draws, intervals, and what is said."""

import warnings
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from pymc_features.calibration.coordinates import Coordinates
from pymc_features.calibration.peaks import Peak
from pymc_features.exceptions import CalibrationWarning
from pymc_features.smc import Reference, prior_points
from pymc_features.smc.proposals.reference import Mode

WANTED = 2.0  # standard deviations beyond a bound that make a warning
SHORT = 2.0  # standard deviations from a bound within which the shortest interval is given: beyond, equal
# tails hardly differ from it, and nearer they never contain the bound
FEW = 0.01  # of the draws between an interval and a bound: the interval ends at the bound
PRIOR_DRAWS = 500  # that tell the width of the prior


class CutNormal(NamedTuple):
    """Map between unconstrained points z (n, d) and standard normal ones u (n, d).

    Coordinates near a bound are normal, each by itself, and cut off there; the others follow them.
    """

    coordinates: Coordinates
    mean: np.ndarray  # of the normal distribution of all coordinates (d,)
    deviations: np.ndarray  # standard deviations of those near a bound (b,)
    follow: np.ndarray  # how the others change with those (f, b)
    factor: np.ndarray  # Cholesky factor of the covariance of the others, given those (f, f)

    @property
    def ends(self):
        """Bounds (2, b), in standard deviations of the coordinates near them."""
        return (self.coordinates.limits - self.mean)[:, self.coordinates.near] / self.deviations

    def forward(self, z):
        """u (n, d), and ln |du/dz| (n,)."""
        near, w, (low, high) = self.coordinates.near, self.coordinates.of(z), self.ends
        u, off = np.empty_like(w), w - self.mean
        x = np.clip(off[:, near] / self.deviations, low, high)
        u[:, near] = ndtri_exp(log_share(low, x) - log_share(low, high))
        u[:, ~near] = np.linalg.solve(self.factor, (off[:, ~near] - off[:, near] @ self.follow.T).T).T
        slopes = 0.5 * (u[:, near] ** 2 - x**2) - log_share(low, high) - np.log(self.deviations)
        slopes += np.log(self.coordinates.slopes(z)[:, near])
        return u, slopes.sum(axis=1) - np.log(np.diag(self.factor)).sum()

    def inverse(self, u):
        """z (n, d)."""
        near, w = self.coordinates.near, self.mean + np.zeros_like(u)
        w[:, near] += self.deviations * quantiles(*self.ends, u[:, near])
        w[:, ~near] += (w - self.mean)[:, near] @ self.follow.T + u[:, ~near] @ self.factor.T
        return self.coordinates.unconstrained(w)


def log_share(low, high):
    """ln of the probability that a standard normal number is between two others.

    SciPy's `truncnorm` has this and the quantiles, but imports the whole of JAX where that is installed.
    """
    right = low + high > 0.0
    low, high = np.where(right, -high, low), np.where(right, -low, high)
    return log_ndtr(high) + np.log1p(-np.exp(log_ndtr(low) - log_ndtr(high)))


def quantiles(low, high, u):
    """Return standard normal numbers between two bounds (b,), at the probabilities Phi(u) (n, b)."""
    sign = np.where(low + high > 0.0, -1.0, 1.0)
    low, high = np.where(sign > 0.0, [low, high], [-high, -low])
    logs = log_ndtr(low) + log_ndtr(-sign * u), log_ndtr(high) + log_ndtr(sign * u)
    return sign * ndtri_exp(np.logaddexp(*logs))


def bell(model, peak: Peak, rng) -> Reference:
    """The calibrated likelihood as it is expected, with the width of the prior where there is no other."""
    prior = prior_points(model, PRIOR_DRAWS, rng)
    centre, scale = prior.mean(axis=0), prior.std(axis=0)
    coordinates, mean, precision = peak.fit.coordinates, peak.free, peak.sandwich.precision
    f, b = np.flatnonzero(~coordinates.near), np.flatnonzero(coordinates.near)
    covariance = np.linalg.inv(precision[np.ix_(f, f)] + np.diag(scale[f] ** -2.0))
    mean[f] += covariance @ ((centre - mean)[f] / scale[f] ** 2)
    follow = -covariance @ precision[np.ix_(f, b)]
    bent = CutNormal(coordinates, mean, peak.deviations[b], follow, np.linalg.cholesky(covariance))
    unit = np.eye(len(mean))
    axes = 0.5 * (bent.inverse(unit) - bent.inverse(-unit)) / scale
    point = (bent.inverse(np.zeros((1, len(mean))))[0] - centre) / scale
    return Reference([Mode(point, np.linalg.cholesky(axes.T @ axes), 0.0, 1)], centre, scale, [bent])


def warn_beyond(found):
    """Warn of parameters that the data want beyond a bound of their prior, see `effective_samples`."""
    rows = (found[name].values for name in ("parameter", "bound", "point", "room"))
    for name, bound, point, room in zip(*rows, strict=True):
        if room < -WANTED:
            warnings.warn(
                f"the data want {name} {'above' if point <= bound else 'below'} {bound:.4g}, the edge of its "
                f"prior, by {-room:.2g} standard deviations: its interval is what the prior leaves of them. "
                "Widen the prior, or look for what the model lacks.",
                CalibrationWarning,
                stacklevel=3,
            )


def interval(draws, probability=0.9, bound=None) -> tuple[float, float]:
    """Equal-tailed interval of draws (n,), or, next to a bound, the shortest: an equal-tailed one never
    contains the bound.
    """
    if bound is None:
        return tuple(map(float, np.quantile(draws, [0.5 - 0.5 * probability, 0.5 + 0.5 * probability])))
    x = np.sort(draws)
    n = int(np.ceil(probability * len(x)))
    first = int(np.argmin(x[n - 1 :] - x[: len(x) - n + 1]))
    low, high = x[first], x[first + n - 1]
    if bound >= high and np.mean((x > high) & (x < bound)) < FEW:
        high = bound
    if bound <= low and np.mean((x > bound) & (x < low)) < FEW:
        low = bound
    return float(low), float(high)
