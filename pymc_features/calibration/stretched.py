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

import copy

import numpy as np
import pytensor.tensor as pt

from pymc_features.calibration.sandwich import directions, whitening
from pymc_features.smc import PersistentSMC, population_logp

FARTHEST = 1e4  # from the maximum: unconstrained values that rounding has made infinite are there


def stretching(information: np.ndarray, precision: np.ndarray) -> tuple[float, np.ndarray]:
    """Power k and matrix C (d, d) with C' (k A) C = the wanted precision (d, d).

    C has determinant one. It is the unit matrix along directions that the likelihood does not tell.
    """
    values, vectors = directions(information, precision)
    power = float(np.exp(np.mean(np.log(values)))) if values.size else 1.0
    along = (vectors * (np.sqrt(values / power) - 1.0)) @ vectors.T
    return power, np.eye(len(information)) + along @ information


class Stretched:
    """Log prior and calibrated log-likelihood around a maximum, evaluated as `PopulationLogp` is.

    Parameters
    ----------
    prior, likelihood : callable
        What has the first and the second result of `PopulationLogp`.
    peak, others : Peak, list of Peak
        What is nearer to another maximum, in standard deviations, has no likelihood here.
    """

    def __init__(self, prior, likelihood, peak, others=()):
        self.prior, self.likelihood = prior, likelihood
        self.peak, *self.others = (p._replace(fit=p.fit._replace(events=[])) for p in (peak, *others))
        near, wanted, off = peak.fit.coordinates.near, peak.sandwich.precision, peak.free - peak.fit.w
        f, b, pushed = np.flatnonzero(~near), np.flatnonzero(near), wanted @ off
        whiten = whitening(wanted[np.ix_(f, f)])
        follow = -whiten @ whiten.T @ wanted[np.ix_(f, b)]
        self.power, stretch = stretching(peak.sandwich.information[np.ix_(f, f)], wanted[np.ix_(f, f)])
        self.origin, self.slope = peak.fit.w.copy(), np.zeros(len(near))
        self.matrix, self.bend = np.zeros((2, len(near), len(near)))
        self.origin[f] -= stretch @ (off[f] - follow @ off[b])
        self.matrix[np.ix_(f, f)], self.matrix[np.ix_(f, b)] = stretch, -stretch @ follow
        self.slope[b] = pushed[b] + follow.T @ pushed[f]
        self.bend[np.ix_(b, b)] = wanted[np.ix_(b, b)] + wanted[np.ix_(b, f)] @ follow

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

    def by(self, likelihood) -> "Stretched":
        """The same of another likelihood."""
        other = copy.copy(self)
        other.likelihood = likelihood
        return other

    def with_rng(self, rng) -> "Stretched":
        """The same, with random streams of its own where numbers are drawn inside."""
        return self.by(self.likelihood.with_rng(rng))

    @property
    def last_error(self) -> str:
        """What the model raised last; empty if nothing did."""
        return self.likelihood.last_error


class StretchedSMC(PersistentSMC):
    """`PersistentSMC` of a stretched likelihood, `logp`."""

    def __init__(self, *given, logp: Stretched, **settings):
        self.logp = logp
        super().__init__(*given, **settings)

    def compile_evaluation(self, model, point, compile_kwargs):
        """All is compiled."""


def prior_and_likelihood(model, compile_kwargs) -> tuple:
    """Evaluations whose first result is the prior, with potentials, and whose second is the likelihood."""
    point, potentials = model.initial_point(), model.potentials

    def of_prior():
        return model.logp(vars=[*model.free_RVs, *potentials]), pt.zeros(())

    def of_data():
        return pt.zeros(()), model.logp(vars=model.observed_RVs)

    prior = population_logp(model, point, compile_kwargs, "prior", of_prior)
    if not potentials:
        return prior, population_logp(model, point, compile_kwargs)
    return prior, population_logp(model, point, compile_kwargs, "data", of_data)
