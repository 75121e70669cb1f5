"""ABC with a hard tolerance by subset simulation."""

import warnings
from typing import NoReturn, Unpack

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pymc.distributions.simulator import SimulatorRV, gaussian, laplace
from pymc.logprob.abstract import _logprob
from pytensor.compile.mode import Mode
from pytensor.graph.traversal import ancestors

from pymc_features._checks import as_numbers, check_keywords, check_share, is_number, message, shown, single
from pymc_features.exceptions import SubsetSimulationWarning, ToleranceNotReachedError
from pymc_features.smc.density.evaluation import population_logp
from pymc_features.smc.kernels.base import KernelOptions, PopulationKernel
from pymc_features.smc.proposals.pool import equal_draws
from pymc_features.smc.proposals.proposal import distinct, fit_mixture


class SimulatorNode:
    """The one `pm.Simulator` node of a model, as a discrepancy rho and a tolerance on it.

    Parameters
    ----------
    model : pymc.Model
        With one simulator among its observed variables; other likelihoods and potentials are allowed.

    Attributes
    ----------
    hard : bool
        Whether the node's own kernel is the threshold rho <= epsilon.

    Notes
    -----
    A distance may have an attribute `minus_rho`, a distance that returns -rho, and `hard`, as those of
    `DiscrepancySimulator`. Of PyMC's, "gaussian" has rho = |s(y) - s(x)|_2 and "laplace" |s(y) - s(x)|_1, and
    of a function of the user's the negative log-density is taken for rho / epsilon. Where epsilon is an
    array, rho stands for that ratio, and its tolerance is 1.
    """

    def __init__(self, model):
        found = [rv for rv in model.observed_RVs if isinstance(rv.owner.op, SimulatorRV)]
        if len(found) != 1:
            names = ", ".join(rv.name for rv in found) or "none"
            raise ValueError(
                f"`model` must have one pm.Simulator node, got {names}. Declare one with "
                "DiscrepancySimulator, or sample with pmf.sample_smc(), which takes any model."
            )
        self.model = model
        [self.rv] = found
        self.op = self.rv.owner.op
        self.distance = type(self.op)._distance  # looked up in the instance, a function would be a method
        if self.model.free_RVs and set(self.model.free_RVs) & set(ancestors([self.op.epsilon])):
            raise TypeError(
                f"`epsilon` of {self.rv.name} must be a number, an array or pm.Data, got one that depends on "
                "random variables. Look at several tolerances with sampling.tolerance_sweep()."
            )
        self.hard = getattr(self.distance, "hard", False)

    @property
    def has_one_tolerance(self) -> bool:
        """Whether epsilon is one number."""
        return self.op.epsilon.ndim == 0

    def tolerance(self, asked=None) -> float:
        """The tolerance asked for, or else the node's, from its data as they are now."""
        if asked is not None and not self.has_one_tolerance:
            wanted = f"left out where {self.rv.name} has one for each sensor"
            raise ValueError(message("epsilon", wanted, shown(asked)))
        epsilon = self.op.epsilon.eval(mode=Mode(linker="py", optimizer=None)) if asked is None else asked
        values = as_numbers(epsilon, "epsilon", what="a number")
        if asked is not None and values.ndim > 0:
            raise ValueError(message("epsilon", "one number", shown(values.tolist())))
        if not (np.isfinite(values) & (values > 0)).all():
            raise ValueError(message("epsilon", "positive and finite", shown(values.tolist())))
        return float(values) if self.has_one_tolerance else 1.0

    def base_terms(self) -> tuple:
        """Log prior, and the log-density of whatever else the model conditions on."""
        others = [rv for rv in self.model.observed_RVs if rv is not self.rv]
        rest = pt.zeros(())
        if others:
            rest = rest + self.model.logp(vars=others)
        if self.model.potentials:
            rest = rest + self.model.potentiallogp
        return self.model.varlogp, rest

    @property
    def conditions_on_more(self) -> bool:
        """Whether the model has other likelihoods or potentials."""
        return len(self.model.observed_RVs) > 1 or len(self.model.potentials) > 0

    def rho_terms(self) -> tuple:
        """Zero, and -rho."""
        [minus_rho] = self.model.replace_rvs_by_values([self._minus_rho()])
        return pt.zeros(()), minus_rho

    def _minus_rho(self):
        value = self.model.rvs_to_values[self.rv]
        inputs = self.rv.owner.inputs
        own = getattr(self.distance, "minus_rho", None)
        changes = {}
        if own is not None:
            changes = {"_distance": own}
        elif self.has_one_tolerance and self.distance in (gaussian, laplace):
            changes = {"epsilon": 1.0}  # no rounding by a division: the edge is exactly where rho = epsilon
        op = type(type(self.op).__name__, (type(self.op),), changes)() if changes else self.op
        minus_rho = pt.sum(_logprob(op, [value], *inputs))
        if self.distance is gaussian:
            minus_rho = -pt.sqrt(-2.0 * minus_rho)
        return minus_rho * self.op.epsilon if not changes and self.has_one_tolerance else minus_rho


# At a hard edge, or with a noisy simulator, short moves are hardly accepted more often than long ones: 0.35
# made up to six times as many simulations, or was out of reach at any length
TARGET_AT_AN_EDGE = 0.1
# What a fitted mixture misses grows with the dimension: from two to eleven parameters the share of local
# proposals rises, and the expected correlation with its first points falls below which a stage may end
LOCAL_SHARES = (0.2, 0.5)
FORGOTTEN = (0.1, 0.001)


class CrossedMoves:
    """Proposals of a Markov chain, as long as their acceptance allows.

    Most are moves of a mixture fitted to points of the target (`StudentMixture.move`): independent of the
    present point at a scale of one, shortened towards it (t-preconditioned Crank-Nicolson, a conditional
    move) below. Some are steps along the difference of two of the points (differential evolution,
    ter Braak 2006): of the right size even in a corner of the target that holds too few points for the
    mixture to see it.

    Moves fitted to the very points they start from fit them too well: few of them lead away, and a population
    keeps the errors of its seeds. So even rows belong to one half, odd rows to the other, and each half is
    moved by what is fitted to the other one.

    Parameters
    ----------
    n_parameters : int
        Dimension of the points.

    Attributes
    ----------
    scales : array (2,)
        Length of the mixtures' moves, up to 1; kept from stage to stage.
    memory : array (2,)
        Expected correlation with the points at which the stage began.
    n_steps : int
        Steps of the stage.
    """

    def __init__(self, n_parameters: int):
        rise = float(np.clip((n_parameters - 2) / 9.0, 0.0, 1.0))
        self.local_share = LOCAL_SHARES[0] + rise * (LOCAL_SHARES[1] - LOCAL_SHARES[0])
        self.forgotten = FORGOTTEN[0] * (FORGOTTEN[1] / FORGOTTEN[0]) ** rise
        self.scales = np.ones(2)

    def fit(self, points, rng: np.random.Generator):
        """Begin a stage: fit to equally weighted points (n, d) of its target."""
        self.points = points[1::2], points[::2]
        self.mixtures = [fit_mixture(*distinct(half), rng) for half in self.points]
        self.memory, self.n_steps = np.ones(2), 0

    def log_density(self, x):
        """Log-density (n,) of each point's mixture."""
        density = np.empty(len(x))
        for k, mixture in enumerate(self.mixtures):
            density[k::2] = mixture.log_density(x[k::2])
        return density

    def propose(self, x, rng: np.random.Generator):
        """Return proposals (n, d), and which of them (n,) are local and hence symmetric."""
        proposal, local = np.empty_like(x), np.empty(len(x), dtype=bool)
        for k, points in enumerate(self.points):
            n, d = x[k::2].shape
            moved = self.mixtures[k].move(x[k::2], self.scales[k], rng)
            a, b = rng.integers(len(points), size=(2, n))
            step = points[a] - points[b]
            local[k::2] = (rng.random(n) < self.local_share) & step.any(axis=1)
            length = 2.38 / np.sqrt(2.0 * d) * np.exp(0.7 * rng.standard_normal(n))
            proposal[k::2] = np.where(local[k::2, None], x[k::2] + length[:, None] * step, moved)
        return proposal, local

    def learn(self, moved):
        """After a step, from which points moved (n,): forget, and shorten moves that are rarely accepted."""
        acceptance = np.array([moved[k::2].mean() for k in range(2)])
        kept = np.sqrt(1.0 - self.scales**2)  # of its distance from the centre, by a moved point
        self.n_steps += 1
        self.memory *= 1.0 - (1.0 - self.local_share) * acceptance * (1.0 - kept)
        gain = 1.0 / np.sqrt(1.0 + 0.1 * self.n_steps)
        self.scales = np.clip(self.scales * np.exp(gain * (acceptance - TARGET_AT_AN_EDGE)), 1e-3, 1.0)

    @property
    def has_forgotten(self) -> bool:
        """Whether little of the stage's first points is left in either half."""
        return bool((self.memory <= self.forgotten).all())


FEWEST = 4  # particles within a tolerance: two for each half
STALLED = (5, 0.01)  # levels in which the way to the tolerance must shorten by this share


class Levels:
    """Tolerances that fall to `epsilon`, each leaving the fraction `p0` of a population.

    Attributes
    ----------
    tolerances : list of float
        Of the levels so far.
    log_probability : float
        Log of P(rho <= last tolerance): the product of the fractions left.
    variance : float
        Squared coefficient of variation of that probability. The fraction of a level varies as the mean over
        its chains does, which accounts for the correlation within each (Au & Beck 2001, Eq. 29); the levels
        are taken for independent.
    """

    def __init__(self, epsilon: float, p0: float):
        self.epsilon, self.p0 = epsilon, p0
        self.tolerances, self.log_probability, self.variance = [], 0.0, 0.0

    def condition(self, log_weights, rng) -> np.ndarray:
        """Positions (n,) of equally weighted draws, from draws of the prior and what else the model says."""
        top = log_weights.max()
        weights = np.exp(log_weights - top) if top > -np.inf else np.zeros(len(log_weights))
        if not weights.sum() ** 2 > 0.1 * len(weights) * (weights @ weights):
            raise ValueError(
                "the model's potentials and other likelihoods must leave room for draws from the prior, got "
                f"{(log_weights > -np.inf).sum()} possible of {len(weights)}, a few of which outweigh the "
                "rest. Put them into the priors, or sample with pmf.sample_smc()."
            )
        mean = weights.mean()
        self.log_probability = float(top + np.log(mean))
        self.variance = float(weights.var() / mean**2 / len(weights))
        return equal_draws(weights / weights.sum(), len(weights), rng)

    @property
    def tolerance(self) -> float:
        """The last tolerance; infinite before the first level."""
        return self.tolerances[-1] if self.tolerances else np.inf

    @property
    def is_last(self) -> bool:
        """Whether the tolerance asked for is reached."""
        return self.tolerance == self.epsilon

    def lower(self, rho, chains) -> np.ndarray:
        """Set the next tolerance; return the positions of the particles within it.

        Parameters
        ----------
        rho : array (n,)
            Discrepancies of the population, infinite where a simulation failed; at least one is not.
        chains : array (n,)
            Number of the Markov chain that each particle belongs to.
        """
        possible = np.sort(rho[np.isfinite(rho)])
        kept = min(int(np.ceil(self.p0 * len(rho))), len(possible))
        reached = possible[kept - 1]
        below = np.searchsorted(possible, self.tolerance)
        if reached == self.tolerance and below >= FEWEST:  # where many share one rho, the next smaller one
            reached = possible[below - 1]
        self.tolerances.append(float(max(reached, self.epsilon)))
        inside = rho <= self.tolerance
        fraction = inside.mean()
        of_chains = np.bincount(chains, inside) / np.bincount(chains)
        self.variance += of_chains.var() / len(of_chains) / fraction**2
        self.log_probability += np.log(fraction)
        return np.flatnonzero(inside)

    @property
    def has_stalled(self) -> bool:
        """Whether the tolerance hardly falls any more, far from where it should go."""
        n_levels, share = STALLED
        if len(self.tolerances) <= n_levels:
            return False
        return self.tolerances[-1 - n_levels] - self.tolerance < share * (self.tolerance - self.epsilon)

    @property
    def progress(self) -> float:
        """An inverse tolerance that is one at the end."""
        return 1.0 if self.is_last else min(self.epsilon / self.tolerance, 1.0 - 1e-9)


MOVES_PER_DRAW = 1.5  # accepted moves in the last level for each draw, so that most draws are distinct
MAX_STEPS = 500  # of a level


class SubsetSimulation(PopulationKernel):
    """Draws from the prior where rho <= epsilon: ABC with a hard tolerance, reached in levels.

    Each level keeps the fraction `p0` of its population with the smallest rho; the largest of these is the
    next tolerance. From every particle kept a Markov chain fills the population up again, within that
    tolerance. The last tolerance is epsilon, and the product of the fractions the evidence P(rho <= epsilon).

    Parameters
    ----------
    draws : int
        Draws to return, all with rho <= epsilon.
    p0 : float
        Fraction of a population that a level keeps, between 0 and 1.
    stage_draws : int, optional
        Population of the levels before the last: half of `draws`, and not less than 50 for each parameter and
        400 in all, by default. More of them make the evidence more exact, and find several narrow modes; few
        of them overestimate it, by a fraction of its standard error.
    epsilon : float, optional
        Tolerance to reach, in place of the node's.
    max_simulations : int, optional
        Simulations after which a chain gives up; 100 for each draw by default.
    model, random_seed
        As of `PopulationKernel`.
    **kwargs
        `start`, `compile_kwargs` and `checkpoint` of `PopulationKernel`. First particles given by `start`
        must be draws from the prior: the evidence rests on it.

    Raises
    ------
    ValueError
        If the model has no `pm.Simulator` node, or several, or an argument is out of range.
    ToleranceNotReachedError
        If `max_simulations` are spent, or the levels make no more headway. The message says how far they
        came. From `pm.sample_smc` with several processes it comes as the cause of a `ParallelSamplingError`;
        `sample_smc` raises it as it is.

    Warns
    -----
    SubsetSimulationWarning
        If the node has a soft kernel, which the hard threshold replaces; if the last level is cut short.

    Notes
    -----
    Works on any model with one `pm.Simulator` node, PyMC's own included: there rho is ``|s(y) - s(x)|``, the
    Euclidean norm for "gaussian" and the sum for "laplace". Noisy simulators are allowed: rho belongs to the
    state of a chain and is never drawn again. Failed simulations are counted and rejected. Proposals that
    the prior rejects are not simulated.

    The moves are those of `PersistentSMC`: a mixture of Student-t distributions fitted to the particles kept,
    independent or conditional on the present point, of a length that adapts to the acceptance, and steps of
    differential evolution. One half of the particles is moved by what is fitted to the other.

    `sample_stats` of each level: its tolerance `epsilon`, `accept_rate`, `evaluations` (simulations),
    `failed`, `log_probability` of the tolerance and its `coefficient_of_variation` (Au & Beck, with the
    correlation within chains), `scale` of the moves; for the chain `log_marginal_likelihood` and its standard
    error.

    References
    ----------
    Chiachio, Beck, Chiachio & Rus, Approximate Bayesian computation by subset simulation, SIAM J. Sci.
    Comput. 36 (2014), A1339-A1358. Vakilzadeh, Huang, Beck & Abrahamsson, Approximate Bayesian computation by
    subset simulation using hierarchical state-space models, Mech. Syst. Signal Process. 84 (2017), 2-20.
    Au & Beck, Estimation of small failure probabilities in high dimensions by subset simulation, Probab.
    Eng. Mech. 16 (2001), 263-277.
    """

    starts_from_prior = True
    densities = ("logp", "base")
    statistics = (
        "epsilon",
        "accept_rate",
        "scale",
        "log_probability",
        "coefficient_of_variation",
        "log_marginal_likelihood_se",
    )
    settings = ("p0", "stage_draws", "epsilon", "max_simulations")

    def __init__(
        self,
        draws: int = 2000,
        *,
        p0: float = 0.2,
        stage_draws: int | None = None,
        epsilon: float | None = None,
        max_simulations: float | None = None,
        **kwargs: Unpack[KernelOptions],
    ):
        check_keywords(kwargs, KernelOptions.__annotations__, "SubsetSimulation")
        self.p0 = check_share(p0, "p0", "The default is 0.2.")
        super().__init__(draws, **kwargs)
        # each half of the particles that a level keeps must show a shape
        self.least = int(np.ceil(4 / self.p0))
        self.stage_draws = self.checked_stage_draws(stage_draws, share=0.5, least=self.least, default=400)
        if max_simulations is None:
            max_simulations = 100 * max(self.draws, self.stage_draws)
        self.max_simulations = single(max_simulations)
        if not (is_number(self.max_simulations) and self.max_simulations >= self.stage_draws):
            raise ValueError(
                f"`max_simulations` must allow for {self.stage_draws} draws from the prior, got "
                f"{shown(max_simulations)}."
            )
        self.epsilon = self.node.tolerance(epsilon)
        if not self.node.hard:
            warnings.warn(
                "SubsetSimulation draws from rho <= epsilon, not with the soft kernel of "
                f"{self.node.rv.name}. For that kernel sample with pmf.sample_smc(); for the threshold "
                'without this warning declare a DiscrepancySimulator with kernel="uniform".',
                SubsetSimulationWarning,
                stacklevel=4,
            )

    def compile_evaluation(self, model: pm.Model, point: dict, compile_kwargs: dict) -> None:
        """Two functions: what can be told without a simulation, and rho."""
        self.node = node = SimulatorNode(model)
        self.conditions_on_more = node.conditions_on_more
        self.base = population_logp(model, point, compile_kwargs, "base", node.base_terms)
        self.logp = population_logp(model, point, compile_kwargs, "rho", node.rho_terms)

    def __getstate__(self):
        return {key: value for key, value in self.__dict__.items() if key != "node"}  # the model stays

    def _initialize_kernel(self):
        """Simulate draws from the prior until enough of them give a number."""
        self.moves, self.levels = CrossedMoves(self.n_parameters), Levels(self.epsilon, self.p0)
        self.simulations, self.smallest = 0, np.inf
        wanted, parts, possible = max(20, 4 * self.n_parameters), [], 0
        while possible < wanted:
            x, base = self.prior_particles()
            if not self.spend(len(x)):
                break
            if len(x) < self.least:
                raise ValueError(
                    f"`start` must hold {self.least} draws from the prior or more, got {len(x)}."
                )
            parts.append((x, base, self.simulate(x)))
            possible += int(np.isfinite(parts[-1][-1]).sum())
            if self.start or (possible == 0 and len(parts) == 2):
                break
        if not parts:
            self.give_up("`start` has more particles than `max_simulations` allows.")
        self.population = [np.concatenate(column) for column in zip(*parts, strict=True)]
        self.chains = np.arange(len(self.population[0]))
        if possible == 0:
            self.refuse_impossible_model()
        if possible < wanted and not self.start:
            self.give_up("`max_simulations` were spent on simulations that fail.")

    def prior_particles(self) -> tuple[np.ndarray, np.ndarray]:
        """Particles (n, d) from the prior and the model's other terms, with the log-density of both."""
        x = self.initial_particles(self.stage_draws)
        prior, rest, _ = self.base(x)
        if self.conditions_on_more:
            chosen = self.levels.condition(rest, self.rng)
            x, prior, rest = x[chosen], prior[chosen], rest[chosen]
        return x, prior + rest

    def simulate(self, x: np.ndarray) -> np.ndarray:
        """rho (n,) of particles (n, d), infinite where the simulation failed; counted."""
        _, minus_rho = self.evaluate(x)
        self.smallest = min(self.smallest, -minus_rho.max())
        return -minus_rho

    def spend(self, n: int) -> bool:
        """Take `n` simulations from the budget; False if they are no longer there."""
        if self.simulations + n > self.max_simulations:
            return False
        self.simulations += n
        return True

    def update_beta_and_weights(self) -> None:
        """Lower the tolerance, and find the particles within it."""
        self.iteration += 1
        self.seeds = self.levels.lower(self.population[2], self.chains)
        self.beta = self.levels.progress
        self.log_marginal_likelihood = self.log_probability = self.levels.log_probability
        self.coefficient_of_variation = float(np.sqrt(self.levels.variance))
        self.log_marginal_likelihood_se = self.coefficient_of_variation if self.levels.is_last else np.nan
        if self.levels.has_stalled:
            self.give_up("The last levels came no nearer: increase `epsilon`, or improve the model.")

    def give_up(self, reason: str) -> NoReturn:
        """Say how far the levels came."""
        raise ToleranceNotReachedError(
            f"`epsilon` must be within reach of the simulator, got {self.epsilon:.6g}: after "
            f"{self.simulations} simulations the tolerance is {self.levels.tolerance:.6g} and the smallest "
            f"rho {self.smallest:.6g}. {reason}"
        )

    def resample(self) -> None:
        """Nothing: all particles within the tolerance begin a chain."""

    def tune(self) -> None:
        """Fit the moves to the particles within the tolerance."""
        self.moves.fit(self.population[0][self.seeds], self.rng)

    def mutate(self) -> None:
        """From each particle kept, a Markov chain within the tolerance; its states are the new population."""
        moves = self.moves
        x, base, rho = (a[self.seeds] for a in self.population)
        density = moves.log_density(x)
        states, acceptances = [(x, base, rho)], []
        while not self.level_is_done(len(x), sum(acceptances) * len(x)):
            proposal, local = moves.propose(x, self.rng)
            prior, rest, _ = self.base(proposal)
            new_density = moves.log_density(proposal)
            log_ratio = prior + rest - base + np.where(local, 0.0, density - new_density)
            tried = np.log(self.rng.random(len(x))) < log_ratio
            if not self.spend(tried.sum()):
                if not self.levels.is_last:
                    self.give_up("Increase `epsilon`, or `max_simulations`, which are spent.")
                self.warn_of_correlation("`max_simulations` were spent")
                break
            new_rho = np.full(len(x), np.inf)
            if tried.any():
                new_rho[tried] = self.simulate(proposal[tried])
            moved = new_rho <= self.levels.tolerance
            x = np.where(moved[:, None], proposal, x)
            base, density = np.where(moved, prior + rest, base), np.where(moved, new_density, density)
            rho = np.where(moved, new_rho, rho)
            states.append((x, base, rho))
            acceptances.append(moved.mean())
            moves.learn(moved)
        self.n_steps, self.scale = moves.n_steps, float(moves.scales.mean())
        self.accept_rate = float(np.mean(acceptances)) if acceptances else np.nan
        self.collect(states)

    def level_is_done(self, n_chains: int, n_accepted: float) -> bool:
        """Whether the chains are long and mixed enough and, in the last level, the draws differ."""
        steps, last = self.moves.n_steps, self.levels.is_last
        if steps >= MAX_STEPS:
            self.warn_of_correlation(f"a level took {MAX_STEPS} steps")
            return True
        if n_chains * (steps + 1) < (self.draws if last else self.stage_draws):
            return False
        return self.moves.has_forgotten and not (last and n_accepted < MOVES_PER_DRAW * self.draws)

    def warn_of_correlation(self, reason: str) -> None:
        """Say that draws repeat more often, or are more correlated, than they should."""
        warnings.warn(
            f"{reason} before the chains had forgotten where they began: draws are correlated. Increase "
            "`stage_draws` or `max_simulations`, or look for parameters that the data do not determine.",
            SubsetSimulationWarning,
            stacklevel=3,
        )

    def collect(self, states: list[tuple]) -> None:
        """Spread the level's new population evenly over the steps of its chains."""
        n_chains, n_steps = len(self.seeds), len(states) - 1
        wanted = self.draws if self.levels.is_last else self.stage_draws
        rows = min(-(-wanted // n_chains), n_steps + 1)
        steps = np.linspace(0 if n_steps < rows else 1, n_steps, rows).round().astype(int)
        self.population = [np.concatenate(column) for column in zip(*(states[k] for k in steps), strict=True)]
        self.chains = np.tile(np.arange(n_chains), rows)
        if self.levels.is_last:
            total = len(self.chains)
            chosen = self.rng.choice(total, self.draws, replace=total < self.draws)
            self.tempered_posterior, _, self.rho = (a[chosen] for a in self.population)

    def sample_stats(self) -> dict:
        """Statistics of the level just finished, its tolerance as `epsilon`."""
        return super().sample_stats() | {"epsilon": self.levels.tolerance}
