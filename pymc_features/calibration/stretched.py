"""Likelihoods that are stretched around their maxima, so that their curvature is another.

    ln L_cal(w) = power ln L(w_hat + C (w - w_hat)),

on the unconstrained scale, where every point is possible (Ribatet, Cooley & Davison, Stat. Sin. 22, 2012).
The prior is not touched: its bounds and its information keep their meaning.

Parameters b near a bound are measured from it (`Coordinates`). With d = w - w_hat, P = A B^-1 A, h = A B^-1 g
and g the score that pushes against the bounds, ln L_cal is meant to be h'd - d'P d / 2, exponential at a
bound and normal away from it. Of that the part of d_b alone is taken as it is, s'd_b - d_b' Q d_b / 2, and
that of the others given d_b is the stretched likelihood at the maximum's w_b:

    ln L_cal = s'd_b - d_b' Q d_b / 2 + power ln L(w_hat_b, w_hat_f + C (d_f - m(d_b))),

with m(d_b) = P_ff^-1 (h_f - P_fb d_b). No likelihood is evaluated outside the prior.
"""

from copy import copy
from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from scipy.special import ndtr, ndtri_exp
from scipy.stats import truncnorm

from pymc_features.calibration.residuals import Coordinates, log_likelihood
from pymc_features.calibration.sandwich import Peak, stretching, whitening
from pymc_features.smc import PersistentSMC, Reference, population_logp, prior_points
from pymc_features.smc.proposals.reference import Mode

CURVED = 0.1  # standard deviations over which curvature is measured
MOST_EXPANDED = 15  # directions in which residuals are expanded: 136 histories are kept for each sensor
FARTHEST = 1e4  # from the maximum: unconstrained values that rounding has made infinite are there
PRIOR_DRAWS = 500  # that tell the width of the prior


class Stretched:
    """Log prior and calibrated log-likelihood around a maximum, evaluated as `PopulationLogp` is.

    `prior` and `likelihood` have the first and the second result of that. What is nearer to the peak of one
    of `others`, in standard deviations, has no likelihood here.
    """

    def __init__(self, prior, likelihood, peak: Peak, others=()):
        near, off = peak.fit.coordinates.near, peak.free - peak.fit.w
        of_free, wanted = np.outer(~near, ~near), peak.precision
        whiten = whitening(wanted * of_free)
        follow = -whiten @ whiten.T @ wanted * near
        self.power, stretch = stretching(peak.information * of_free, wanted * of_free)
        self.matrix = ~near[:, None] * (stretch @ (np.eye(len(near)) - follow))
        self.origin, pushed = peak.fit.w - self.matrix @ off, wanted @ off
        self.slope = near * (pushed + follow.T @ pushed)
        self.bend = np.outer(near, near) * (wanted + wanted @ follow)
        self.peak, *self.others = (p._replace(fit=p.fit._replace(events=[])) for p in (peak, *others))
        self.prior, self.likelihood = prior, likelihood

    def __call__(self, z):
        """Log prior, log-likelihood and failures, each (n,), of unconstrained points (n, d)."""
        coordinates = self.peak.fit.coordinates
        off = np.clip(coordinates.of(z) - self.peak.fit.w, -FARTHEST, FARTHEST)
        _, value, failed = self.likelihood(coordinates.unconstrained(self.origin + off @ self.matrix.T))
        value = self.power * value + off @ self.slope - 0.5 * np.einsum("ni,ij,nj->n", off, self.bend, off)
        if self.others:
            nearest = self.peak.distance(z) <= np.min([other.distance(z) for other in self.others], axis=0)
            value = np.where(nearest, value, -np.inf)
        return self.prior(z)[0], value, failed

    def with_rng(self, rng) -> "Stretched":
        """Take random streams of its own where numbers are drawn inside."""
        other = copy(self)
        other.likelihood = self.likelihood.with_rng(rng)
        return other

    @property
    def last_error(self) -> str:
        """What the model raised last; empty if nothing did."""
        return self.likelihood.last_error

    @property
    def draws_random_numbers(self) -> bool:
        """Whether two evaluations of the same point may differ."""
        return self.likelihood.draws_random_numbers


class StretchedSMC(PersistentSMC):
    """`PersistentSMC` of a stretched likelihood, `logp`."""

    def __init__(self, *given, logp: Stretched, **settings):
        self.logp = logp
        super().__init__(*given, **settings)

    def compile_evaluation(self, model, point, compile_kwargs):
        """All is compiled."""


def prior_and_likelihood(predictions, compile_kwargs) -> tuple:
    """Evaluations whose first result is the prior, with potentials, and whose second is the likelihood."""
    model, point, zero = predictions.model, predictions.space.point, pt.zeros(())
    of_prior = [*model.free_RVs, *model.potentials]
    prior = "potentials", lambda: (model.logp(vars=of_prior), zero)
    data = "data", lambda: (zero, model.logp(vars=model.observed_RVs))
    of_model = data if model.potentials else ()  # without, what `sample` has compiled
    return tuple(population_logp(model, point, compile_kwargs, *terms) for terms in (prior, of_model))


class Expansion(NamedTuple):
    """A log-likelihood near its maximum along some axes, by second derivatives of residuals and scales.

    Where a response is smooth, draws by it need hardly be weighed, and cost no response.
    """

    coordinates: Coordinates
    point: np.ndarray  # where the expansion is made (d,)
    along: np.ndarray  # how far a change of coordinates goes along each axis (k, d)
    gram: np.ndarray  # (sensor, c, c) of the coefficients of 1, of each axis, and of each pair of axes
    log_scale: np.ndarray  # coefficients of ln s (c, sensor)
    claimed: np.ndarray  # m (sensor,), see `comparison`
    last_error = ""

    def __call__(self, z):
        """Nothing, log-likelihood and no failures, each (n,), of unconstrained points (n, d)."""
        a = (self.coordinates.of(z) - self.point) @ self.along.T
        first, second = np.triu_indices(a.shape[1])
        with np.errstate(over="ignore", invalid="ignore"):  # far away
            terms = np.concatenate([np.ones((len(a), 1)), a, a[:, first] * a[:, second]], axis=1)
            squares = np.stack([np.sum((terms @ gram) * terms, axis=1) for gram in self.gram], axis=1)
            log_scale = terms @ self.log_scale
            value = (-0.5 * np.exp(-2.0 * log_scale) * squares - log_scale * self.claimed).sum(axis=1)
        return None, np.where(np.isfinite(value), value, -np.inf), np.zeros(len(a), dtype=bool)

    def with_rng(self, rng) -> "Expansion":
        """Return itself, for nothing is drawn."""
        return self


def curved(predictions, peak: Peak) -> tuple[Peak, Expansion | None]:
    """The peak with the likelihood's own curvature as A, where that is positive, and its expansion.

    Both are along the axes of A, of parameters not near a bound: where they are correlated, a change of one
    alone by its standard deviation leads far away. No expansion along many axes.
    """
    fit, free = peak.fit, ~peak.fit.coordinates.near
    whiten = whitening(peak.information * np.outer(free, free))
    widths = np.sqrt(np.diag(whiten.T @ peak.variability @ whiten))
    steps = CURVED * np.minimum(widths, 1.0)
    axes, k, at_maximum = (whiten * steps).T, len(steps), predictions(fit.z)

    def value(w):
        values = predictions(fit.coordinates.unconstrained(w))
        found = [[log_likelihood(values)]]
        if k <= MOST_EXPANDED:
            log_scales = [v.log_scale - here.log_scale for v, here in zip(values, at_maximum, strict=True)]
            unscaled = [np.exp(s)[:, None] * v.residuals for s, v in zip(log_scales, values, strict=True)]
            found += log_scales + [x.ravel() for x in unscaled]
        return np.concatenate(found)

    columns = second_order(value, fit.w, axes)
    curvature = np.zeros((k, k))
    curvature[np.triu_indices(k)] = -columns[1 + k :, 0]
    relative = (curvature + curvature.T) / np.outer(steps, steps)
    if np.linalg.eigvalsh(relative).min(initial=np.inf) > 0:
        unwhiten = whiten.T @ peak.information
        more = unwhiten.T @ (relative - np.eye(k)) @ unwhiten
        peak = peak._replace(information=peak.information + more)
    if k > MOST_EXPANDED:
        return peak, None
    claimed = np.concatenate([v.claimed for v in at_maximum])
    lengths = [1, len(claimed), *(v.mu.shape[-1] for v in at_maximum for _ in v.claimed)]
    _, log_scale, *series = np.split(columns, np.cumsum(lengths[:-1]), axis=1)
    gram = np.array([x @ x.T for x in series])
    return peak, Expansion(fit.coordinates, fit.w, np.linalg.pinv(axes).T, gram, log_scale, claimed)


def second_order(value, w, axes) -> np.ndarray:
    """Coefficients (c, n) of 1, of each axis (k, d) and of each pair, in a function of points (d,)."""
    here = value(w)
    ends = [np.reshape([value(w + s * axis) for axis in axes], (len(axes), len(here))) for s in (1.0, -1.0)]
    middle, pairs = 0.5 * (ends[0] + ends[1]) - here, []
    for i, j in zip(*np.triu_indices(len(axes)), strict=True):
        if i == j:
            pairs.append(middle[i])
        else:
            both = value(w + axes[i] + axes[j]) + value(w - axes[i] - axes[j])
            pairs.append(0.5 * both - here - middle[i] - middle[j])
    return np.array([here, *(0.5 * (ends[0] - ends[1])), *pairs])


class CutNormal(NamedTuple):
    """Map between unconstrained points z (n, d) and standard normal ones u (n, d).

    Coordinates near a bound are normal, each by itself, and cut off there; the others follow them.
    """

    coordinates: Coordinates
    mean: np.ndarray  # of the normal distribution of all coordinates (d,)
    factor: np.ndarray  # of its covariance (d, d); diagonal in the rows of those near a bound

    @property
    def cut(self):
        """Distributions (b,) of coordinates near a bound, in standard deviations from the mean."""
        ends = (self.coordinates.limits - self.mean) / np.diag(self.factor)
        return truncnorm(*ends[:, self.coordinates.near])

    def forward(self, z):
        """u (n, d), and ln |du/dz| (n,)."""
        near, cut = self.coordinates.near, self.cut
        u = np.linalg.solve(self.factor, (self.coordinates.of(z) - self.mean).T).T
        x = np.clip(u[:, near], *cut.support())
        u[:, near] = ndtri_exp(cut.logcdf(x))
        slopes = 0.5 * (u[:, near] ** 2 + np.log(2.0 * np.pi)) + cut.logpdf(x)
        slopes += np.log(self.coordinates.slopes(z)[:, near])
        return u, slopes.sum(axis=1) - np.linalg.slogdet(self.factor)[1]

    def inverse(self, u):
        """z (n, d)."""
        near, x = self.coordinates.near, np.array(u)
        of_near, cut = u[:, near], self.cut
        x[:, near] = np.where(of_near > 0.0, cut.isf(ndtr(-of_near)), cut.ppf(ndtr(of_near)))
        return self.coordinates.unconstrained(self.mean + x @ self.factor.T)


def bell(model, peak: Peak, rng) -> Reference:
    """The calibrated likelihood as it is expected, with the width of the prior where there is no other."""
    prior = prior_points(model, PRIOR_DRAWS, rng)
    centre, scale = prior.mean(axis=0), prior.std(axis=0)
    near, mean, precision = peak.fit.coordinates.near, peak.free, peak.precision
    wide = np.where(near, peak.deviations, scale) ** -2.0
    covariance = np.linalg.inv(precision * np.outer(~near, ~near) + np.diag(wide))
    mean += ~near * (covariance @ (~near * (centre - mean) * wide))
    follow = ~near[:, None] * (covariance @ precision) * near
    factor = (np.eye(len(mean)) - follow) @ np.linalg.cholesky(covariance)
    bent, unit = CutNormal(peak.fit.coordinates, mean, factor), np.eye(len(mean))
    axes = 0.5 * (bent.inverse(unit) - bent.inverse(-unit)) / scale
    point = (bent.inverse(np.zeros((1, len(mean))))[0] - centre) / scale
    return Reference([Mode(point, np.linalg.cholesky(axes.T @ axes), 0.0, 1)], centre, scale, [bent])
