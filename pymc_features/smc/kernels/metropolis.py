"""Published kernels on whole populations: PyMC's two of Metropolis, and TMCMC of Ching & Chen (2007)."""

from typing import Unpack

import numpy as np
from pymc.pytensorf import floatX
from pymc.smc import IMH, MH
from scipy.optimize import brentq

from pymc_features._checks import check_keywords, check_positive
from pymc_features.smc.kernels.base import KernelOptions, PopulationKernel


class Metropolis(PopulationKernel):
    """Steps of a stage that go on for as long as particles move away from where they began."""

    def __init__(
        self,
        draws: int = 2000,
        *,
        threshold: float = 0.5,
        correlation_threshold: float = 0.01,
        **kwargs: Unpack[KernelOptions],
    ):
        check_keywords(kwargs, KernelOptions.__annotations__, type(self).__name__)
        advice = "0.01 is usual."
        self.correlation_threshold = check_positive(correlation_threshold, "correlation_threshold", advice)
        PopulationKernel.__init__(self, draws, threshold=threshold, **kwargs)
        self.proposal_dist = None


class PopulationMH(Metropolis, MH):
    """Random-walk Metropolis: the particles of `pymc.smc.MH`, evaluated all at once.

    Parameters
    ----------
    correlation_threshold : float
        Steps of a stage go on while the correlation with its first particles falls by more than this.
    draws, threshold, start, model, random_seed, compile_kwargs, checkpoint
        As of `PopulationKernel`.

    Notes
    -----
    The same seed gives the same particles as PyMC's kernel (tests/smc/test_population.py).
    """

    proposal_scales = chain_acc_rate = None
    statistics = ("mean_accept_rate", "mean_proposal_scale")

    def propose(self) -> tuple[np.ndarray, np.ndarray | float, np.ndarray | float]:
        """Step from each particle, with the covariance of all and a scale of its own."""
        step = self.proposal_dist(num_draws=self.draws, rng=self.rng)
        return floatX(self.tempered_posterior + step * self.proposal_scales[:, None]), 0.0, 0.0

    def mutate(self) -> None:
        """Metropolis steps; their acceptance sets the scales of the next stage."""
        super().mutate()
        self.chain_acc_rate = np.mean(self.accepted, axis=0)
        self.mean_accept_rate = float(self.chain_acc_rate.mean())
        self.mean_proposal_scale = float(self.proposal_scales.mean())


class PopulationIMH(Metropolis, IMH):
    """Independent Metropolis-Hastings: the particles of `pymc.smc.IMH`, evaluated all at once.

    Parameters
    ----------
    correlation_threshold : float
        Steps of a stage go on while the correlation with its first particles falls by more than this.
    draws, threshold, start, model, random_seed, compile_kwargs, checkpoint
        As of `PopulationKernel`.

    Notes
    -----
    The same seed gives the same particles as PyMC's kernel (tests/smc/test_population.py). Like there,
    1e-6 is added to the variances of the proposal, which starves posteriors narrower than 1e-3 in the sampled
    coordinates: take `PersistentSMC` for those.
    """

    statistics = ("accept_rate",)

    def propose(self) -> tuple[np.ndarray, np.ndarray | float, np.ndarray | float]:
        """Draw from the Gaussian fitted to the resampled particles."""
        proposal = floatX(self.proposal_dist.rvs(size=self.draws, random_state=self.rng))
        proposal = proposal.reshape(len(proposal), -1)
        forward = self.proposal_dist.logpdf(proposal)
        return proposal, self.proposal_dist.logpdf(self.tempered_posterior), forward


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
    statistics = ("accept_rate",)
    settings = ("scale", "coefficient_of_variation")

    def __init__(
        self,
        draws: int = 2000,
        *,
        scale: float = 0.2,
        coefficient_of_variation: float = 1.0,
        **kwargs: Unpack[KernelOptions],
    ):
        check_keywords(kwargs, KernelOptions.__annotations__, "TMCMC")
        advice = "Leave it out for the source's."
        self.scale = check_positive(scale, "scale", advice)
        self.coefficient_of_variation = check_positive(
            coefficient_of_variation, "coefficient_of_variation", advice
        )
        super().__init__(draws, **kwargs)

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
        self.accept_rate = float(n_accepted / self.draws)


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
