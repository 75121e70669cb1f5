"""TMCMC as Ching & Chen (2007) wrote it, on whole populations."""

from os import PathLike

import numpy as np
import pymc as pm
from pymc.util import RandomState
from scipy.optimize import brentq

from pymc_features._checks import check_positive
from pymc_features.smc.kernels.base import PopulationKernel


class TMCMC(PopulationKernel):
    """Transitional Markov chain Monte Carlo, for comparison with published results.

    Temperatures rise such that the coefficient of variation of the weights is one. Seeds are drawn by
    weight, and each makes a random-walk Metropolis step for every time it was drawn, its covariance the
    weighted one of the sample times 0.2^2; all states visited are the next sample.

    Parameters
    ----------
    draws : int
        N, the number of samples of each stage.
    scale : float
        beta of the source, the proposal's standard deviation over the sample's.
    coefficient_of_variation : float
        Of the weights of a stage.
    start, model, random_seed, compile_kwargs, checkpoint
        As of `PopulationKernel`.

    Notes
    -----
    One step for each sample from seeds that occur many times: samples are correlated, and in many
    dimensions the chains hardly move between temperatures, so that the evidence is biased. `PersistentSMC`
    costs less and has neither defect. The walk takes place in PyMC's unbounded coordinates.

    References
    ----------
    Ching & Chen, Transitional Markov chain Monte Carlo method for Bayesian model updating, model class
    selection, and model averaging, J. Eng. Mech. 133, 816-832 (2007),
    doi:10.1061/(ASCE)0733-9399(2007)133:7(816).
    """

    starts_from_prior = True
    stats_dtypes_shapes = {**PopulationKernel.stats_dtypes_shapes, "accept_rate": (float, [])}

    def __init__(
        self,
        draws: int = 2000,
        *,
        scale: float = 0.2,
        coefficient_of_variation: float = 1.0,
        start: dict | None = None,
        model: pm.Model | None = None,
        random_seed: RandomState = None,
        compile_kwargs: dict | None = None,
        checkpoint: str | PathLike | None = None,
    ):
        advice = "Leave it out for the source's."
        self.scale = check_positive(scale, "scale", advice)
        self.coefficient_of_variation = check_positive(
            coefficient_of_variation, "coefficient_of_variation", advice
        )
        super().__init__(
            draws,
            start=start,
            model=model,
            random_seed=random_seed,
            compile_kwargs=compile_kwargs,
            checkpoint=checkpoint,
        )

    def update_beta_and_weights(self) -> None:
        """Next temperature, weights, and the factor S_j of the evidence."""
        self.iteration += 1
        old = self.beta
        self.beta = transitional_beta(self.likelihood_logp, old, self.coefficient_of_variation)
        log_weights = (self.beta - old) * self.likelihood_logp
        total = np.logaddexp.reduce(log_weights)
        self.weights = np.exp(log_weights - total)
        self.weights /= self.weights.sum()
        self.log_marginal_likelihood += total - np.log(self.draws)

    def resample(self) -> None:
        """Draw how many steps each sample makes."""
        self.counts = self.rng.multinomial(self.draws, self.weights)

    def tune(self) -> None:
        """Covariance of the proposal: the weighted one of the sample, scaled."""
        mean = self.weights @ self.tempered_posterior
        centred = self.tempered_posterior - mean
        covariance = (self.weights[:, None] * centred).T @ centred
        variances = np.diag(covariance)
        if not (np.isfinite(variances).all() and (variances > 0).all()):
            raise ValueError(
                f"the weighted sample must vary in every parameter, got a variance of {variances.min():g}. "
                "Increase `draws`: too few of them were inside the posterior."
            )
        self.factor = self.scale * np.linalg.cholesky(covariance + 1e-9 * np.diag(variances))

    def mutate(self) -> None:
        """One chain for each seed, as long as it was drawn often; all states are kept."""
        alive = np.flatnonzero(self.counts)
        remaining = self.counts[alive]
        x, prior, likelihood = (
            a[alive] for a in (self.tempered_posterior, self.prior_logp, self.likelihood_logp)
        )
        kept, n_accepted = [], 0
        self.n_steps = int(remaining.max())
        while len(x):
            proposal = x + self.rng.standard_normal(x.shape) @ self.factor.T
            new_prior, new_likelihood = self.evaluate(proposal)
            log_ratio = (new_prior - prior) + self.beta * (new_likelihood - likelihood)
            accepted = np.log(self.rng.random(len(x))) < log_ratio
            n_accepted += accepted.sum()
            x = np.where(accepted[:, None], proposal, x)
            prior, likelihood = (
                np.where(accepted, new, old)
                for new, old in ((new_prior, prior), (new_likelihood, likelihood))
            )
            kept.append((x, prior, likelihood))
            remaining = remaining - 1
            going = remaining > 0
            x, prior, likelihood, remaining = x[going], prior[going], likelihood[going], remaining[going]
        self.tempered_posterior, self.prior_logp, self.likelihood_logp = (
            np.concatenate(column) for column in zip(*kept, strict=True)
        )
        self.accept_rate = n_accepted / self.draws

    def sample_stats(self) -> dict:
        """Statistics of the stage just finished."""
        return {**super().sample_stats(), "accept_rate": float(self.accept_rate)}

    def sample_settings(self) -> dict:
        """Settings, saved as attributes of `sample_stats`."""
        return {
            "_n_draws": self.draws,
            "scale": self.scale,
            "coefficient_of_variation": self.coefficient_of_variation,
        }


def transitional_beta(log_likelihood, beta: float, coefficient_of_variation: float) -> float:
    """Temperature, at most 1, at which the weights have this coefficient of variation; on a log scale."""
    possible = log_likelihood[log_likelihood > -np.inf]
    relative = possible - possible.max()
    n = len(log_likelihood)

    def excess(log_increase):
        w = np.exp(np.exp(log_increase) * relative)
        return np.log(n * (w @ w) / w.sum() ** 2) - np.log1p(coefficient_of_variation**2)

    full = np.log1p(-beta)
    if excess(full) <= 0.0:
        return 1.0
    spread = -relative.min()
    least = np.log(1e-3 / spread) if spread > 0 else full
    if excess(least) >= 0.0:  # many impossible samples: the possible ones are all there is
        return float(beta + np.exp(least)) if spread > 0 else 1.0
    return float(beta + np.exp(brentq(excess, least, full, xtol=1e-10)))
