"""Importance sampling from a mixture of Student distributions fitted to draws, and a share of the prior.

The share of the prior keeps the weights finite where the mixture has too little.
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.known.exact.chains import effective
from benchmarks.known.exact.estimates import pareto_shape
from benchmarks.known.exact.peak import with_peak
from pymc_features.smc.proposals.proposal import fit_mixture

PRIOR_SHARE = 0.02
FITTED = 20_000  # draws behind the fit
BATCH = 20_000


@dataclass(frozen=True, eq=False)
class Weighted:
    """Points z (n, d) and log weights (n,): independent draws from a proposal, target over proposal."""

    z: np.ndarray
    log_weights: np.ndarray

    @property
    def weights(self):
        """Relative weights (n,)."""
        return np.exp(self.log_weights - self.log_weights.max())

    @property
    def efficiency(self):
        """Effective share of the points."""
        return effective(self.log_weights)

    @property
    def pareto_shape(self):
        """Of the largest weights."""
        return pareto_shape(self.log_weights)

    @property
    def log_evidence(self):
        """Estimate and standard error."""
        mean = self.weights.mean()
        error = self.weights.std(ddof=1) / np.sqrt(len(self.weights)) / mean
        return float(np.log(mean) + self.log_weights.max()), float(error)


def normal_density(z):
    """ln N(z; 0, I) (n,)."""
    return -0.5 * (z**2).sum(axis=1) - 0.5 * z.shape[1] * np.log(2.0 * np.pi)


def proposal_from(target, draws, rng):
    """The mixture for draws (n, d), with a component at the highest point."""
    chosen = rng.choice(len(draws), size=min(FITTED, len(draws)), replace=False)
    chosen = np.asarray(draws[chosen], dtype=float)
    return with_peak(target, fit_mixture(chosen, np.ones(len(chosen)), rng), chosen)


def log_proposal(mixture, z, of_prior):
    """Log-density of the mixture and its share of the prior, at points (n, d)."""
    return np.logaddexp(np.log(PRIOR_SHARE) + of_prior, np.log1p(-PRIOR_SHARE) + mixture.log_density(z))


def log_ratio(target, mixture, z):
    """ln of prior times likelihood over proposal at points (n, d)."""
    of_prior = normal_density(z)
    return of_prior + target.log_likelihood(z) - log_proposal(mixture, z, of_prior)


def sample(target, mixture, rng, keep_going):
    """Weighted points while `keep_going(number, effective number)` says so."""
    z, log_weights = [], []
    done, sums = 0, np.zeros(2)
    reference = None
    while keep_going(done, sums[0] ** 2 / sums[1] if sums[1] else 0.0):
        prior = rng.random(BATCH) < PRIOR_SHARE
        new = mixture.move(np.zeros((BATCH, target.d)), 1.0, rng)
        new[prior] = rng.standard_normal((prior.sum(), target.d))
        log_w = log_ratio(target, mixture, new)
        reference = log_w.max() if reference is None else reference
        w = np.exp(np.minimum(log_w - reference, 600.0))
        sums += w.sum(), (w**2).sum()
        done += BATCH
        z.append(new.astype(np.float32))
        log_weights.append(log_w)
    return Weighted(np.concatenate(z), np.concatenate(log_weights))
