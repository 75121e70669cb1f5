"""Persistent sampling: chains from temperature to temperature, then independent draws."""

import warnings
from typing import NamedTuple, Unpack

import numpy as np

from pymc_features._checks import check_flag, check_keywords, check_model, message, shown
from pymc_features.exceptions import SamplingWarning
from pymc_features.smc.density.prior import are_logits
from pymc_features.smc.kernels.base import KernelOptions, PopulationKernel
from pymc_features.smc.kernels.chains import Chains, FittedMoves
from pymc_features.smc.proposals.pool import GROUPS, LARGEST_K, LARGEST_SHARE, Pool, equal_draws, next_beta
from pymc_features.smc.proposals.reference import MANY, Reference, good_share
from pymc_features.smc.proposals.unbending import fit_to

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

# of independent draws at the end, from the reference or from fits, until there are enough
FIT_POINTS, FIRST_DRAWS = 350, 200  # of a fit, and from the first fit of the last stage, for each parameter
MAX_EVALUATIONS = 500  # of the last stage, for each draw
FOR_TAILS = 8  # and of more fits where a few draws outweigh the rest
HEAVY_K = 0.3  # Pareto shape of weights above which draws do not decide themselves how many are enough
TRIAL = 0.25  # worth, of `draws`, of those that decide then
MOST_TRIALS, BETTER = 5, 1.5  # of fits that follow each other, each better than the one before by this factor
MARGIN, ADDITION = 1.1, 0.2  # numbers that are drawn and, if they are worth too little, added: over the need
REFIT = 0.2  # worth, of `draws`, of what has been drawn, below which another fit follows
TOO_FEW = "PersistentSMC ended with draws worth {:.0f} of {}. Increase `stage_draws`, or narrow the priors."


class Trial(NamedTuple):
    """What draws of a fit have shown, with those of the reference.

    Attributes
    ----------
    rate : float
        What the draws are worth, over their number.
    fit : int
        Number of the density.
    of_reference : float
        Share of the reference in them.
    """

    rate: float
    fit: int
    of_reference: float


class PersistentSMC(PopulationKernel):
    """Sequential Monte Carlo that keeps what it has evaluated, and ends with independent draws.

    Points of all stages stay in a pool that is reweighted to each new temperature (persistent sampling,
    Karamanis & Seljak 2025; `pool.py`). A stage fits a proposal to the weighted pool, a Student-t mixture
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
    statistics = (
        "accept_rate",
        "hamiltonian_share",
        "steps_per_draw",
        "effective",
        "reference_efficiency",
        "log_marginal_likelihood_se",
        "ess",
        "pareto_k",
        "largest_share",
    )
    settings = ("threshold", "stage_draws")

    def __init__(
        self,
        draws: int = 2000,
        *,
        reference: Reference | None = None,
        gradients: bool = False,
        stage_draws: int | None = None,
        threshold: float = 0.5,
        **kwargs: Unpack[KernelOptions],
    ):
        check_keywords(kwargs, KernelOptions.__annotations__, "PersistentSMC")
        self.gradients_allowed = check_flag(gradients, "gradients")
        if not (reference is None or isinstance(reference, Reference)):
            raise TypeError(message("reference", "what `find_reference` returned", shown(reference)))
        super().__init__(draws, threshold=threshold, **kwargs)
        if gradients:
            self.logp.compile_gradient()
        stage_draws = self.checked_stage_draws(stage_draws, share=0.4, least=20, default=200)
        self.stage_draws = GROUPS * -(-stage_draws // GROUPS)
        self.n_chains = GROUPS * max(2, self.stage_draws // (KEPT_STEPS * GROUPS))
        self.given_reference = reference
        sizes = [size for _, size in self.var_info.values()]
        self.bounded = np.repeat(are_logits(check_model(kwargs.get("model"))), sizes)

    def _initialize_kernel(self):
        """Begin with draws from the reference, if there is a good one, or else from the prior."""
        self.moves, self.reference = FittedMoves(self.bounded), self.given_reference
        self.accept_rate = self.steps_per_draw = self.log_marginal_likelihood_se = np.nan
        self.ess = self.pareto_k = self.largest_share = np.nan
        self.reference_efficiency, self.hamiltonian_share, self.fit_efficiency = 0.0, 0.0, 1.0
        self.reference_is_good, self.repeats = False, 0
        if self.reference is not None and self.begin_with_reference():
            return
        self.reference = self.pool = None
        wanted = max(20, 4 * self.n_parameters)
        for _ in range(1 if self.start else MORE_PRIOR):
            particles = self.initial_particles(2 * self.stage_draws)
            add = Pool if self.pool is None else self.pool.add_draws
            self.pool = add(particles, *self.weigh(particles)) or self.pool
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
        values = self.relative(particles, prior, likelihood)
        if self.reference is None:
            return *values, of_prior, of_likelihood
        of_reference = self.reference.gradient(particles, prior, of_prior)
        return *values, of_reference, of_prior + of_likelihood - of_reference

    def update_beta_and_weights(self) -> None:
        """Choose the next temperature and weigh the pool for it; stay where the chains hardly moved."""
        self.iteration += 1
        pool = self.pool
        if self.accept_rate < LEAST_ACCEPTANCE and self.repeats < MAX_REPEATS:
            self.repeats += 1
            return
        self.repeats = 0
        now = pool.effective(pool.log_weights(self.beta))
        least, each = FEWEST_EFFECTIVE
        target = max(self.threshold * min(now, 3.0 * self.n_chains), least, each * self.n_parameters)
        self.beta = next_beta(pool, self.beta, target)
        pool.add_density(self.beta, pool.log_evidence(pool.log_weights(self.beta)))
        self.last_stage = len(pool.betas)

    def resample(self) -> None:
        """Choose the points at which the chains of the stage start."""
        self.position = equal_draws(self.pool.shares(self.beta), self.n_chains, self.rng)

    def tune(self) -> None:
        """Fit the proposal to the weighted pool, if independent draws from the reference will not do."""
        if not self.reference_is_good:
            self.moves.fit(self.fitting_points(), self.rng)

    def mutate(self) -> None:
        """Advance chains of this temperature; at the end, draw from fits to all points."""
        self.n_steps, self.steps_per_draw, self.hamiltonian_share = 1, 1.0, 0.0  # of independent draws
        if not (self.reference_is_good or self.fit_is_good()):
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
        self.steps_per_draw = chains.measure()
        self.pool.solve()
        self.n_steps = chains.n_steps
        self.accept_rate = float(np.mean(chains.acceptances))
        self.hamiltonian_share = chains.n_hamiltonian / chains.n_steps

    def advance_until_a_fit_is_usable(self) -> None:
        """At a temperature of one, let chains go on while draws from fits to them are worth hardly anything.

        Points of the stages before may be too few to show how the posterior is bent. The next fit, to the
        draws of the one before as well, costs little beside chains.
        """
        for trial in range(MOST_ROUNDS * TRIALS):
            self.moves.fit(self.fitting_points(), self.rng)
            if self.try_fit() > USABLE_FIT:
                break
            if (trial + 1) % TRIALS:
                continue
            self.resample()
            self.advance(OF_TRAJECTORIES)
        self.last_stage = len(self.pool.betas) - 1  # the fit that none of its draws has shaped

    def fit_is_good(self) -> bool:
        """Whether independent draws from the fit of a stage do instead of chains."""
        return self.fit_efficiency >= WORTH_A_TRIAL and self.try_fit() > GOOD_FIT

    def try_fit(self) -> float:
        """Draw from the fit of a stage, and return the effective share of its draws."""
        source = self.pool.add_proposal(self.moves.proposal)
        self.draw_more(self.stage_draws, source)
        self.fit_efficiency = self.accept_rate = self.pool.efficiency(source, self.beta)
        return self.fit_efficiency

    def fitting_points(self) -> np.ndarray:
        """Equally weighted points of the pool (n, d) for a fit, at the present temperature."""
        shares = self.pool.shares(self.beta)
        n = min(max(FIT_POINTS * self.n_parameters, 2 * self.stage_draws), len(shares))
        return self.pool.particles[equal_draws(shares, n, self.rng)]

    def complete(self) -> None:
        """Draw from the reference, or fits that follow each other, until that is worth `draws`.

        Only draws count that have shaped no fit: of the last one. If few show that more is missing than
        were drawn in all, it draws as many, and another one follows. So it does where a few draws outweigh
        the rest. A good reference that is bent stands in for the fit.
        Where weights are heavy, draws of a fit are a trial only: other fits follow, to these draws as well,
        as long as they become better; then see `drawn_anew`.
        """
        pool, used, limit, drawn, before_tails, trials = self.pool, 0, 0, 0, None, []
        source = self.last_stage if self.last_stage in pool.proposals else 0  # drawn from in place of chains
        first, most = max(FIRST_DRAWS * self.n_parameters, self.draws // 4), MAX_EVALUATIONS * self.draws
        while True:
            numbers = pool.known(max(source, self.last_stage))
            sample = pool.independent(numbers)
            n_sample, worth, k = sample.counts.sum(), sample.worth(), sample.pareto_k()
            heavy, again = bool(sample.proposals) and k > HEAVY_K, False
            missing = max((TRIAL if heavy else 1.0) * self.draws - worth, 0.0)
            if not missing and before_tails is None:
                before_tails = used
            refit = not missing and used - before_tails + n_sample < FOR_TAILS * self.draws
            refit = refit and k > LARGEST_K and sample.largest_share() > LARGEST_SHARE
            if not (missing or refit) and heavy and used < most:
                trials.append(Trial(worth / n_sample, pool.known()[-1], sample.counts[0] / n_sample))
                again = self.pays_to_fit_again(trials)
                if not again:
                    sample, n = self.drawn_anew(trials)
                    used, worth, trials, numbers = used + n, sample.worth(), [], None
                    refit = worth < REFIT * self.draws
            refit = refit or again
            if not (missing or refit) or used >= most:
                break
            n = 1.1 * missing * max(1.0, n_sample / max(worth, 1.0))
            poor = worth < good_share(self.n_parameters) * n_sample
            if refit or (poor and n > max(used, first)):
                n = 0 if refit else limit - drawn
                if n <= 0:
                    source, n, limit, drawn = self.fit_again(), first, max(used, first), 0
            n = int(np.clip(n, 0.1 * self.draws, 2.0 * self.draws + used))
            self.draw_more(n, source)
            used, drawn = used + n, drawn + n
        unseen = sample if numbers is None else pool.unseen(numbers)
        if worth < self.draws:
            warnings.warn(TOO_FEW.format(worth, self.draws), SamplingWarning, stacklevel=2)
            if self.hamiltonian_share > 0.0 and pool.worth() > worth:  # chains got about
                sample = unseen = pool
        self.ess = worth
        self.finish(sample, unseen)

    def pays_to_fit_again(self, trials: list[Trial]) -> bool:
        """Whether another fit is likely to be better than the last one, which is not a good one."""
        *before, last = trials
        better = not before or last.rate > BETTER * before[-1].rate
        return better and last.rate < good_share(self.n_parameters) and len(trials) < MOST_TRIALS

    def fit_again(self) -> int:
        """Fit to the whole pool; the number of the fit."""
        points = self.fitting_points()
        # draws in many dimensions, a few of them heavy, are too few for a fit to be as good
        bent = self.reference_is_good and self.n_parameters >= MANY
        fit = self.reference.mixture if bent else fit_to(points, self.rng, self.bounded, twice=True)
        return self.pool.add_proposal(fit)

    def drawn_anew(self, trials: list[Trial]) -> tuple[Pool, int]:
        """Draws of the two best fits and the reference, alone, as many as the trials show to be enough.

        Draws seem enough the sooner, and a fit the better, the fewer of them have fallen where weights are
        heavy. Draws that decide make tails too light: of the deviation between eight schools the 95 %
        quantile was too small by 4 % of the 5-95 % width.

        Returns the draws and their number. They are worth less than `draws` where there are `MAX_EVALUATIONS`
        of them for each, and less than `REFIT` of it where the trials were wrong.
        """
        pool, mark, used, best = self.pool, self.pool.mark(), 0, sorted(trials)[-2:]
        numbers = np.array([0, *sorted(trial.fit for trial in best)])
        rate, _, of_reference = np.mean(best, axis=0)
        shares = np.append(of_reference, np.full(len(best), (1.0 - of_reference) / len(best)))
        n = min(MARGIN / rate, MAX_EVALUATIONS) * self.draws
        counts = first = np.ceil(n * shares).astype(int)
        while True:
            for source, n in zip(numbers, counts, strict=True):
                if n:
                    self.draw_more(n, source)
            used += int(counts.sum())
            anew = pool.independent(numbers, mark)
            worth = anew.worth()
            enough = worth >= self.draws or worth < REFIT * self.draws
            if enough or used >= MAX_EVALUATIONS * self.draws:
                return anew, used
            counts = np.ceil(ADDITION * first).astype(int)

    def draw_more(self, n: int, source: int) -> None:
        """Independent draws from the reference or prior, or from a fit."""
        x = self.pool.proposals[source].draw(n, self.rng) if source else self.draw_reference(n)
        self.pool.add_draws(x, *self.weigh(x), source)
        self.pool.solve()

    def finish(self, sample: Pool, unseen: Pool) -> None:
        """Draw equally weighted points from independent draws; evidence by those that have shaped no fit."""
        self.log_marginal_likelihood, self.log_marginal_likelihood_se = unseen.evidence()
        self.pareto_k, self.largest_share = sample.pareto_k(), sample.largest_share()
        weights = sample.normalised(sample.posterior_log_weights())
        self.tempered_posterior = sample.particles[equal_draws(weights, self.draws, self.rng)]

    @property
    def effective(self) -> float:
        """Independent points behind the stage's weights."""
        return self.pool.effective(self.pool.log_weights(self.beta))

    def sample_settings(self) -> dict:
        """Settings, saved as attributes of `sample_stats`."""
        return super().sample_settings() | {"gradients": int(self.gradients_allowed)}
