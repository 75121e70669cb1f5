"""What to draw from first: a normal distribution of the wanted width, which bounds of priors cut off."""

from typing import NamedTuple

import numpy as np
from scipy.stats import norm, truncnorm

from pymc_features.calibration.coordinates import Coordinates
from pymc_features.calibration.peaks import Peak
from pymc_features.smc import Reference, prior_points
from pymc_features.smc.proposals.reference import Mode

PRIOR_DRAWS = 500


class CutNormal(NamedTuple):
    """Map between unconstrained points z (n, d) and standard normal ones u (n, d).

    Coordinates near a bound are normal, each by itself, and cut off there; the others follow them.

    Attributes
    ----------
    coordinates : Coordinates
    mean : array (d,)
        Of the normal distribution of all coordinates.
    deviations : array (b,)
        Standard deviations of those near a bound.
    follow : array (f, b)
        How the others change with those.
    factor : array (f, f)
        Cholesky factor of the covariance of the others, given those.
    """

    coordinates: Coordinates
    mean: np.ndarray
    deviations: np.ndarray
    follow: np.ndarray
    factor: np.ndarray

    @property
    def cut(self):
        """Distribution of the coordinates near a bound."""
        near, limits = self.coordinates.near, self.coordinates.limits
        low, high = ((ends - self.mean)[near] / self.deviations for ends in limits)
        return truncnorm(low, high, self.mean[near], self.deviations)

    def forward(self, z):
        """u (n, d), and ln |du/dz| (n,)."""
        near, w = self.coordinates.near, self.coordinates.of(z)
        u, off = np.empty_like(w), w - self.mean
        u[:, near] = norm.ppf(self.cut.cdf(w[:, near]))
        u[:, ~near] = np.linalg.solve(self.factor, (off[:, ~near] - off[:, near] @ self.follow.T).T).T
        slopes = self.cut.logpdf(w[:, near]) - norm.logpdf(u[:, near])
        slopes += np.log(self.coordinates.slopes(z)[:, near])
        return u, slopes.sum(axis=1) - np.log(np.diag(self.factor)).sum()

    def inverse(self, u):
        """z (n, d)."""
        near, w = self.coordinates.near, self.mean + np.zeros_like(u)
        w[:, near] = self.cut.ppf(norm.cdf(u[:, near]))
        w[:, ~near] += (w - self.mean)[:, near] @ self.follow.T + u[:, ~near] @ self.factor.T
        return self.coordinates.unconstrained(w)


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
