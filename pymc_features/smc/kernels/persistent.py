"""Persistent sampling: a kernel that throws no evaluation away."""

import warnings
from os import PathLike

import numpy as np
import pymc as pm
from pymc.util import RandomState

from pymc_features.smc.kernels.base import PopulationKernel
from pymc_features.smc.proposals.mixture import GROUPS, Pool, equal_draws, next_beta
from pymc_features.smc.proposals.moves import AdaptiveMoves

LOCAL_INFLATION = 3.0  # local steps that count for one independent point, roughly
MAX_STEPS = 500
REFIT_AFTER = 2  # times the draws of a stage, in one that goes on
MORE_PRIOR = 50  # the prior is drawn from at most this many times, in search of possible points


class PersistentSMC(PopulationKernel):
    """Sequential Monte Carlo in which every evaluation of every stage counts in the result.

    All points ever evaluated, prior draws and rejected proposals included, stay in a pool that is
    reweighted to each new temperature (persistent sampling, Karamanis & Seljak 2025; `mixture.py`). A stage
    starts a few chains from points of the pool and keeps all their states (waste-free SMC, Dau & Chopin
    2022). The last stage goes on until the pool is worth `draws` independent draws from the posterior; as
    many equally weighted ones are returned.

    Parameters
    ----------
    draws : int
        Equally weighted draws to return, and the effective number of points to reach.
    stage_draws : int, optional
        Evaluations of a stage: two fifths of `draws`, and not less than 50 for each parameter and 200 in all,
        by default. The prior is evaluated at twice as many.
    threshold : float
        Effective number of points that a new temperature keeps, over `stage_draws`.
    start, model, random_seed, compile_kwargs, checkpoint
        As of `PopulationKernel`.

    Notes
    -----
    Proposals come from a mixture of Student-t distributions fitted to the weighted pool: independent of the
    present point where many are accepted, shortened towards it (t-preconditioned Crank-Nicolson) where few
    are. A fifth of them are steps of differential evolution. A long stage fits the mixture again as it goes.

    `sample_stats` has besides those of `PopulationKernel`: `accept_rate`, `scale` (1: independent proposals),
    `effective` (points behind the stage's weights) and, at the end, `log_marginal_likelihood_se`: its
    standard error, by a jackknife over chains. A constant added to the log-likelihood changes nothing but
    the evidence. Cost and accuracy beside other samplers: benchmarks/.

    References
    ----------
    Karamanis & Seljak, Persistent sampling, Statistics and Computing 35 (2025). Dau & Chopin, Waste-free
    sequential Monte Carlo, J. R. Stat. Soc. B 84 (2022).
    """

    starts_from_prior = True
    stats_dtypes_shapes = {
        **PopulationKernel.stats_dtypes_shapes,
        "accept_rate": (float, []),
        "scale": (float, []),
        "effective": (float, []),
        "log_marginal_likelihood_se": (float, []),
    }

    def __init__(
        self,
        draws: int = 2000,
        *,
        stage_draws: int | None = None,
        threshold: float = 0.5,
        start: dict | None = None,
        model: pm.Model | None = None,
        random_seed: RandomState = None,
        compile_kwargs: dict | None = None,
        checkpoint: str | PathLike | None = None,
    ):
        super().__init__(
            draws,
            threshold=threshold,
            start=start,
            model=model,
            random_seed=random_seed,
            compile_kwargs=compile_kwargs,
            checkpoint=checkpoint,
        )
        stage_draws = self.checked_stage_draws(stage_draws, share=0.4, least=20, default=200)
        self.stage_draws = GROUPS * -(-stage_draws // GROUPS)

    def _initialize_kernel(self):
        """Evaluate draws from the prior until enough of them are possible."""
        wanted = max(20, 4 * self.n_parameters)
        self.moves, self.standard_error, self.pool = AdaptiveMoves(self.n_parameters), np.nan, None
        for _ in range(1 if self.start else MORE_PRIOR):
            particles = self.initial_particles(2 * self.stage_draws)
            more = Pool(particles, *self.evaluate(particles))
            if self.pool is None:
                self.pool = more
            else:
                self.pool.add_prior(more)
            if len(self.pool.mass) >= wanted:
                break
        if not len(self.pool.mass):
            self.refuse_impossible_model()

    def update_beta_and_weights(self) -> None:
        """Choose the next temperature and weigh the pool for it."""
        self.iteration += 1
        self.beta = next_beta(self.pool, self.beta, self.threshold * self.stage_draws)
        log_weights = self.pool.log_weights(self.beta)
        self.weights = self.pool.normalised(log_weights)
        self.pool.add_temperature(self.beta, self.pool.log_evidence(log_weights))

    def resample(self) -> None:
        """Choose the points at which the chains of the stage start."""
        n_chains = GROUPS * max(1, self.stage_draws // (5 * GROUPS))
        self.position = equal_draws(self.weights, n_chains, self.rng)

    def tune(self) -> None:
        """Fit the proposal to the weighted pool."""
        self.moves.fit(self.fitting_points(self.weights), self.rng)

    def fitting_points(self, weights: np.ndarray) -> np.ndarray:
        """Equally weighted points of the pool (n, d) for a fit."""
        return self.pool.particles[equal_draws(weights, 2 * self.stage_draws, self.rng)]

    def mutate(self) -> None:
        """Advance all chains until the stage is done, keeping every state and every proposal."""
        pool, position, moves = self.pool, self.position, self.moves
        x, prior = pool.particles[position], pool.log_prior[position]
        likelihood, density = pool.log_likelihood[position], moves.mixture.log_density(x)
        group = np.arange(len(x))
        acceptances, refit_every = [], REFIT_AFTER * -(-self.stage_draws // len(x))
        while not self.stage_is_done(len(x)):
            proposal, local = moves.propose(x, self.rng)
            new_prior, new_likelihood = self.evaluate(proposal)
            new_density = moves.mixture.log_density(proposal)
            log_ratio = new_prior - prior + self.beta * (new_likelihood - likelihood)
            log_ratio += np.where(local, 0.0, density - new_density)
            probability = np.exp(np.minimum(log_ratio, 0.0))
            possible = probability > 0
            np.add.at(pool.mass, position, 1.0 - probability)  # chains may share a point
            ahead = position.copy()
            inflation = np.where(local, LOCAL_INFLATION, (1.0 + moves.kept) / (1.0 - moves.kept))
            added = (proposal, new_prior, new_likelihood, probability, inflation, group)
            ahead[possible] = pool.add(*(values[possible] for values in added))
            pool.counts[-1] += len(x)
            moved = self.rng.random(len(x)) < probability
            x = np.where(moved[:, None], proposal, x)
            prior, likelihood = np.where(moved, [new_prior, new_likelihood], [prior, likelihood])
            density, position = np.where(moved, new_density, density), np.where(moved, ahead, position)
            acceptances.append(probability.mean())
            moves.learn(acceptances[-1])
            if moves.n_steps % refit_every == 0:
                # a long stage knows more and more of its target than it did at its beginning
                weights = pool.normalised(pool.log_weights(self.beta))
                moves.refit(self.fitting_points(weights), self.rng)
                density = moves.mixture.log_density(x)
        self.n_steps, self.accept_rate = moves.n_steps, float(np.mean(acceptances))
        pool.solve()
        if self.beta == 1.0:
            self.finish()

    def stage_is_done(self, n_chains: int) -> bool:
        """Whether the chains are long and mixed enough and, at the end, the pool is worth `draws`."""
        if self.moves.n_steps * n_chains < self.stage_draws:
            return False
        if self.moves.n_steps >= MAX_STEPS:
            warnings.warn(
                f"a stage of PersistentSMC ended after {MAX_STEPS} steps before it was worth its draws. "
                "Increase `stage_draws`, or look for parameters that the data do not determine.",
                stacklevel=2,
            )
            return True
        if not self.moves.has_forgotten:
            return False
        if self.beta < 1.0:
            return True
        # to weigh the pool takes as long as a few steps: in a long stage, not after each
        if self.moves.n_steps % max(1, self.moves.n_steps // 10):
            return False
        return self.pool.effective(self.pool.log_weights(1.0)) >= self.draws

    def finish(self) -> None:
        """Draw equally weighted points from the pool; evidence and its standard error."""
        pool = self.pool
        self.log_marginal_likelihood = pool.log_z[-1]
        self.standard_error = pool.standard_error()
        self.weights = pool.normalised(pool.log_weights(1.0))
        chosen = equal_draws(self.weights, self.draws, self.rng)
        self.tempered_posterior = pool.particles[chosen]
        self.prior_logp, self.likelihood_logp = pool.log_prior[chosen], pool.log_likelihood[chosen]

    def sample_stats(self) -> dict:
        """Statistics of the stage just finished."""
        return {
            **super().sample_stats(),
            "accept_rate": self.accept_rate,
            "scale": self.moves.scale,
            "effective": self.pool.effective(self.pool.log_weights(self.beta)),
            "log_marginal_likelihood_se": self.standard_error,
        }

    def sample_settings(self) -> dict:
        """Settings, saved as attributes of `sample_stats`."""
        return {"_n_draws": self.draws, "threshold": self.threshold, "stage_draws": self.stage_draws}
