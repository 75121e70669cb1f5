"""Persistent sampling: chains from temperature to temperature, then independent draws."""

from typing import Unpack

import numpy as np
import pymc as pm
from pymc.util import RandomState

from pymc_features._checks import check_flag, check_keywords, check_model, message, shown
from pymc_features.smc.density.prior import are_logits
from pymc_features.smc.kernels.base import KernelOptions, PopulationKernel
from pymc_features.smc.kernels.chains import Chains
from pymc_features.smc.kernels.last_draws import LastDraws
from pymc_features.smc.proposals.arms import FittedMoves
from pymc_features.smc.proposals.mixture import equal_draws, next_beta
from pymc_features.smc.proposals.pool import GROUPS, LARGEST_K, Pool
from pymc_features.smc.proposals.reference import Reference, good_share

MORE_PRIOR = 50  # the prior is drawn from at most this many times, in search of possible points
KEPT_STEPS, LAST_STEPS = 8, 32  # of the chains of a stage, and of those of the last
FEWEST_EFFECTIVE = (60, 8)  # points that a new temperature keeps at least: in all, and for each parameter
LEAST_ACCEPTANCE, MAX_REPEATS = 0.01, 5  # chains that move less repeat their stage
GOOD_FIT = 0.3  # effective share of its draws, of a fit of a stage that needs no chains
# the same of the last stage, below which chains go on; how often; their share of trajectories then
USABLE_FIT, MOST_ROUNDS, OF_TRAJECTORIES = 0.03, 6, 0.7
TRIALS = 3  # of fits that follow each other, before chains go on
WORTH_A_TRIAL = 0.2  # of the last fit, below which the next is not tried
FIRST_OF_REFERENCE = (400, 30)  # draws of the reference: at least, and for each parameter
USABLE_REFERENCE = 0.05  # effective share of its draws, to begin with
WORST_QUANTILE = 0.8  # what the draws of a good one are worth for the worst quantile, over that share
LONG_WAY = 25.0  # from prior to posterior, in nats, such that a reference that is only usable saves stages
OF_LAST_DRAWS = "ess", "pareto_k", "largest_share"
STATISTICS = "accept_rate", "hamiltonian_share", "steps_per_draw", "reference_efficiency", *OF_LAST_DRAWS


class PersistentSMC(LastDraws, PopulationKernel):
    """Sequential Monte Carlo that keeps what it has evaluated, and ends with independent draws.

    Points of all stages stay in a pool that is reweighted to each new temperature (persistent sampling,
    Karamanis & Seljak 2025; `mixture.py`). A stage fits a proposal to the weighted pool, a Student-t mixture
    or one behind a map that unbends the posterior, and draws from it. If these draws are not effective
    enough, chains start from points of the pool. Their states count once they have measurably forgotten where
    they started, and then all of them do (waste-free SMC, Dau & Chopin 2022), with the number of steps that
    make an independent one. At the end, fits to the pool are drawn from until the quantiles of each parameter
    are worth `draws` independent draws; those of the last fit alone give the posterior, with Pareto smoothed
    weights, and the evidence. Where weights are heavy, fits are tried by some draws first, as long as they
    become better, and draws of the two best fits that follow count alone.

    Parameters
    ----------
    draws : int
        Equally weighted draws to return, and the independent draws to be worth.
    reference : Reference, optional
        First guess of the posterior, see `find_reference`. If importance sampling from it is good, there is
        no path; if it is usable and the prior far away, the path leads from there, and else from the prior.
    gradients : bool
        Whether chains may follow Hamiltonian trajectories where their other moves hardly get anywhere.
    stage_draws : int, optional
        States of the chains that a stage keeps: by default two fifths of `draws`, 50 for each parameter or
        200, whatever is most. The prior is evaluated at twice as many.
    threshold : float
        Effective number of points that a new temperature keeps, over those of the one before.
    start, model, random_seed, compile_kwargs, checkpoint
        As of `PopulationKernel`.

    Notes
    -----
    The chains move by independent draws from the proposal, by shorter moves that leave it invariant, and by
    differential evolution, with and without the map; each kind as often as it pays in the run itself. So do
    Hamiltonian trajectories; a gradient counts for three values, a constant for the sake of reproducible
    draws. Where no fit is good at the end, there is a warning; if chains followed trajectories, their points
    count as well, and the standard error of the evidence is then too small.

    `sample_stats` has besides those of `PopulationKernel`: `accept_rate`, `hamiltonian_share` (of the steps
    that were trajectories), `steps_per_draw` (of the chains, for one independent draw), `effective`
    (independent points behind the stage's weights), `reference_efficiency` (effective share of the
    reference's draws; 0 without one) and, at the end, `log_marginal_likelihood_se` (standard error, by a
    jackknife, and what smoothing would change), `ess` (independent draws that the quantiles of the worst
    parameter are worth), `pareto_k` (of the final weights: above 0.7 they mislead if draws are heavy) and
    `largest_share` (of the posterior, that the heaviest draw stands for before weights are smoothed). A
    constant added to the log-likelihood changes nothing but the evidence.
    There is a `SamplingWarning` if the last stage ends before its draws are worth `draws`.

    References
    ----------
    Karamanis & Seljak, Persistent sampling, Statistics and Computing 35 (2025). Dau & Chopin, Waste-free
    sequential Monte Carlo, J. R. Stat. Soc. B 84 (2022).
    """

    starts_from_prior = True
    stats_dtypes_shapes = {
        **PopulationKernel.stats_dtypes_shapes,
        **dict.fromkeys((*STATISTICS, "effective", "log_marginal_likelihood_se"), (float, [])),
    }

    def __init__(
        self,
        draws: int = 2000,
        *,
        reference: Reference | None = None,
        gradients: bool = False,
        stage_draws: int | None = None,
        threshold: float = 0.5,
        model: pm.Model | None = None,
        random_seed: RandomState = None,
        **kwargs: Unpack[KernelOptions],
    ):
        check_keywords(kwargs, KernelOptions.__annotations__, "PersistentSMC")
        self.gradients_allowed = check_flag(gradients, "gradients")
        if not (reference is None or isinstance(reference, Reference)):
            raise TypeError(message("reference", "what `find_reference` returned", shown(reference)))
        super().__init__(draws, threshold=threshold, model=model, random_seed=random_seed, **kwargs)
        if gradients:
            self.logp.compile_gradient()
        stage_draws = self.checked_stage_draws(stage_draws, share=0.4, least=20, default=200)
        self.stage_draws = GROUPS * -(-stage_draws // GROUPS)
        self.n_chains = GROUPS * max(2, self.stage_draws // (KEPT_STEPS * GROUPS))
        self.given_reference = reference
        self.bounded = np.repeat(are_logits(check_model(model)), [size for _, size in self.var_info.values()])

    def _initialize_kernel(self):
        """Begin with draws from the reference, if there is a good one, or else from the prior."""
        self.moves, self.reference = FittedMoves(self.bounded), self.given_reference
        self.accept_rate = self.steps_per_draw = self.standard_error = np.nan
        self.ess = self.pareto_k = self.largest_share = np.nan
        self.reference_efficiency, self.hamiltonian_share, self.fit_efficiency = 0.0, 0.0, 1.0
        self.reference_is_good = False
        self.repeats = 0
        if self.reference is not None and self.begin_with_reference():
            return
        self.reference = self.pool = None
        wanted = max(20, 4 * self.n_parameters)
        for _ in range(1 if self.start else MORE_PRIOR):
            particles = self.initial_particles(2 * self.stage_draws)
            weights = self.weigh(particles)
            if self.pool is None:
                self.pool = Pool(particles, *weights)
            else:
                self.pool.add_draws(particles, *weights)
            if len(self.pool.visits) >= wanted:
                break
        if not len(self.pool.visits):
            self.refuse_impossible_model()

    def begin_with_reference(self) -> bool:
        """Draw from the reference; return whether it is good, or usable and far from the prior."""
        least, each = FIRST_OF_REFERENCE
        particles = self.draw_reference(max(least, each * self.n_parameters))
        prior, likelihood = self.evaluate(particles)
        self.pool = pool = Pool(particles, *self.relative(particles, prior, likelihood))
        self.reference_efficiency = pool.efficiency(0)
        self.reference_is_good = self.reference_is_confirmed()
        if self.reference_is_good:
            return True
        if self.reference_efficiency < USABLE_REFERENCE or pool.pareto_k() > LARGEST_K:
            return False
        log_weights = pool.log_weights(1.0)
        possible = prior + likelihood > -np.inf
        shares = pool.normalised(log_weights)[: possible.sum()]  # of the first draws
        information = shares @ likelihood[possible] / shares.sum() - pool.log_evidence(log_weights)
        return information > LONG_WAY

    def reference_is_confirmed(self) -> bool:
        """Whether as many draws of the reference as are wanted in the end, if the first few are, are good.

        Where the posterior has a part beyond the reference, few draws are there, and heavy: without one among
        the first, all looks well. The quantile that this part shifts shows it before the whole does.
        """
        share = good_share(self.n_parameters)
        if self.reference_efficiency <= share:
            return False
        if (missing := self.draws - self.pool.counts[0]) > 0:
            self.draw_more(int(missing), 0)
            self.reference_efficiency = self.pool.efficiency(0)
        worth = self.pool.worth() / self.pool.counts[0]
        good = self.reference_efficiency > share and worth > WORST_QUANTILE * share
        return good and self.pool.pareto_k() <= LARGEST_K

    def draw_reference(self, n: int) -> np.ndarray:
        """Independent draws (n, d) from the reference, or from the prior if there is none."""
        of_prior = self.initial_particles
        return of_prior(n) if self.reference is None else self.reference.draw(n, of_prior, self.rng)

    def weigh(self, particles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log reference, and log prior plus log-likelihood less that, each (p,)."""
        return self.relative(particles, *self.evaluate(particles))

    def relative(self, x: np.ndarray, prior: np.ndarray, likelihood: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return relative weights of particles (p, d) that have been evaluated."""
        if self.reference is None:
            return prior, likelihood
        log_reference = self.reference.log_density(x, prior)
        return log_reference, prior + likelihood - log_reference

    def slopes(self, particles: np.ndarray) -> tuple[np.ndarray, ...]:
        """What `weigh` returns, and the gradients (p, d) of both."""
        prior, likelihood, of_prior, of_likelihood = self.evaluate_gradient(particles)
        if self.reference is None:
            return prior, likelihood, of_prior, of_likelihood
        log_reference = self.reference.log_density(particles, prior)
        of_reference = self.reference.gradient(particles, prior, of_prior)
        ratio = prior + likelihood - log_reference
        return log_reference, ratio, of_reference, of_prior + of_likelihood - of_reference

    def update_beta_and_weights(self) -> None:
        """Choose the next temperature and weigh the pool for it; stay where the chains hardly moved."""
        self.iteration += 1
        pool = self.pool
        if self.accept_rate < LEAST_ACCEPTANCE and self.repeats < MAX_REPEATS:
            self.repeats += 1
            self.weights = pool.normalised(pool.log_weights(self.beta))
            return
        self.repeats = 0
        now = pool.effective(pool.log_weights(self.beta))
        least, each = FEWEST_EFFECTIVE
        target = max(self.threshold * min(now, 3.0 * self.n_chains), least, each * self.n_parameters)
        self.beta = next_beta(pool, self.beta, target)
        log_weights = pool.log_weights(self.beta)
        self.weights = pool.normalised(log_weights)
        pool.add_density(self.beta, pool.log_evidence(log_weights))
        self.last_stage = len(pool.betas)

    def resample(self) -> None:
        """Choose the points at which the chains of the stage start."""
        self.position = equal_draws(self.weights, self.n_chains, self.rng)

    def tune(self) -> None:
        """Fit the proposal to the weighted pool, if independent draws from the reference will not do."""
        self.needs_fit = self.reference is None or not self.reference_is_good
        if self.needs_fit:
            self.moves.fit(self.fitting_points(), self.rng)

    def mutate(self) -> None:
        """Advance chains of this temperature; at the end, draw from fits to all points."""
        self.n_steps, self.steps_per_draw, self.hamiltonian_share = 1, 1.0, 0.0  # of independent draws
        if self.needs_fit and not self.fit_is_good():
            self.advance()
            if self.beta == 1.0:
                self.advance_until_a_fit_is_usable()
        if self.beta == 1.0:
            self.complete()

    def advance(self, of_trajectories: float = 0.0) -> None:
        """Let chains forget where they start, and keep what follows, with so many trajectories or more."""
        slopes = self.slopes if self.gradients_allowed else None
        chains = Chains(self.pool, self.position, self.moves, self.beta, self.weigh, self.rng, slopes)
        chains.forget(of_trajectories)
        for _ in range(KEPT_STEPS if self.beta < 1.0 else LAST_STEPS):
            chains.step()
        chains.measure()
        self.pool.solve()
        self.n_steps, self.steps_per_draw = chains.n_steps, chains.inflation
        self.accept_rate = float(np.mean(chains.acceptances))
        self.hamiltonian_share = chains.n_hamiltonian / chains.n_steps

    def advance_until_a_fit_is_usable(self) -> None:
        """At a temperature of one, let chains go on while draws from fits to them are worth hardly anything.

        Points of the stages before may be too few to show how the posterior is bent. The next fit, to the
        draws of the one before as well, costs little beside chains.
        """
        for trial in range(MOST_ROUNDS * TRIALS):
            self.weights = self.pool.normalised(self.pool.log_weights(1.0))
            self.moves.fit(self.fitting_points(), self.rng)
            if self.try_fit() > USABLE_FIT:
                break
            if (trial + 1) % TRIALS:
                continue
            self.weights = self.pool.normalised(self.pool.log_weights(1.0))
            self.resample()
            self.advance(OF_TRAJECTORIES)
        self.last_stage = len(self.pool.betas) - 1  # the fit that none of its draws has shaped

    def fit_is_good(self) -> bool:
        """Whether independent draws from the fit of a stage do instead of chains."""
        return self.fit_efficiency >= WORTH_A_TRIAL and self.try_fit() > GOOD_FIT

    def try_fit(self) -> float:
        """Draw from the fit of a stage, and return the effective share of its draws."""
        self.pool.add_proposal(self.moves.proposal)
        source = len(self.pool.betas) - 1
        self.draw_more(self.stage_draws, source)
        self.fit_efficiency = self.accept_rate = self.pool.efficiency(source, self.beta)
        return self.fit_efficiency

    def sample_stats(self) -> dict:
        """Statistics of the stage just finished."""
        own = {name: getattr(self, name) for name in STATISTICS}
        own["effective"] = self.pool.effective(self.pool.log_weights(self.beta))
        return {**super().sample_stats(), **own, "log_marginal_likelihood_se": self.standard_error}

    def sample_settings(self) -> dict:
        """Settings, saved as attributes of `sample_stats`."""
        own = {"stage_draws": self.stage_draws, "_n_draws": self.draws}
        return {"threshold": self.threshold, "gradients": int(self.gradients_allowed), **own}
