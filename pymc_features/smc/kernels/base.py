"""What the kernels share that evaluate a whole population at once."""

import time
from collections.abc import Callable
from os import PathLike
from typing import NoReturn, TypedDict

import numpy as np
import pymc as pm
from pymc.smc.kernels import SMC_KERNEL
from pymc.util import RandomState
from pymc.vartypes import discrete_types

from pymc_features._checks import (
    as_numbers,
    check_finite,
    check_integer,
    check_mapping,
    check_model,
    check_path,
    check_seed,
    check_share,
)
from pymc_features.smc.density.evaluation import PopulationLogp, population_logp
from pymc_features.smc.density.prior import prior_draws
from pymc_features.smc.kernels.checkpoint import chain_journal, evaluated, model_fingerprint


def checked_start(start, variables) -> dict[str, np.ndarray]:
    """First particles by variable (particle, ...), all as many."""
    names = [v.name for v in variables]
    advice = f"Pass arrays (particle, ...) of {', '.join(names)}, on the scale they are sampled on."
    start = check_mapping(start, "start", "a dict of variables to their particles", advice)
    if missing := [name for name in names if name not in start]:
        raise ValueError(f"`start` must have all variables, got none of {', '.join(missing)}. {advice}")
    values = {name: as_numbers(start[name], "start", advice) for name in names}
    for array in values.values():
        check_finite(array, "start", advice)
    fits = all(values[v.name].ndim == v.ndim + 1 for v in variables)
    if not fits or 0 in (lengths := {len(x) for x in values.values()}) or len(lengths) > 1:
        got = ", ".join(f"{name} {array.shape}" for name, array in values.items())
        raise ValueError(f"`start` must have equally many particles of all variables, got {got}. {advice}")
    return values


class KernelOptions(TypedDict, total=False):
    """Arguments of `PopulationKernel` that other kernels take as they come."""

    model: pm.Model | None
    random_seed: RandomState
    start: dict | None
    compile_kwargs: dict | None
    checkpoint: str | PathLike | None


class PopulationKernel(SMC_KERNEL):
    """Base of the kernels for `pm.sample_smc` that evaluate all particles in one compiled call.

    A kernel proposes (`propose`) and adapts (`tune`); the stages, the temperatures and the resampling are
    PyMC's. It knows nothing of structures: any PyMC model runs on it. Models that cannot be vectorised,
    such as those with a `pm.Simulator` whose function takes one set of parameters, are evaluated particle
    by particle, with one `PopulationWarning`.

    Parameters
    ----------
    draws : int
        Number of particles.
    threshold : float
        Effective number of particles that a new temperature keeps, over `draws`, between 0 and 1; of kernels
        whose temperatures are PyMC's.
    start : dict, optional
        Values of the variables (particle, ...), on the scale they are sampled on; draws from the prior by
        default.
    model : pymc.Model, optional
        That of the context by default.
    random_seed : int or Generator, optional
        For the same particles each time.
    compile_kwargs : dict, optional
        For `pytensor.function`.
    checkpoint : path-like, optional
        Folder that keeps every evaluation; a run that was killed goes on from there with the same
        `random_seed`, to the same particles. See `sample_smc`.

    Notes
    -----
    `sample_stats` of each stage: `n_steps` Markov chain steps, `evaluations` of the likelihood (those of the
    initial population count for the first stage), `gradients` (evaluations with a gradient, not counted among
    the others), `failed` simulations of both kinds, and `seconds`. Particles whose log-density is not finite
    have probability zero, each on its own; nothing raises in between.

    A kernel that takes gradients calls `self.logp.compile_gradient()` when it is made: a model without one is
    refused there, and no process of a chain compiles.
    """

    # PyMC starts every particle of a variable with an `initval` there, and those of discrete variables at
    # integers of the real line they move on. Where the first particles must be draws from the prior, both
    # are undone.
    starts_from_prior = False
    densities = ("logp",)  # attributes that evaluate populations
    correlation_threshold = 0.01  # of `mutate`, as in PyMC
    statistics: tuple[str, ...] = ()  # attributes of a kernel that are numbers of the stage just finished
    settings: tuple[str, ...] = ("threshold", "_n_tune", "correlation_threshold")  # attributes, as in PyMC
    _n_tune = property(lambda self: self.n_steps)

    def __init_subclass__(cls, **kwargs):
        super().__init_subclass__(**kwargs)
        counts = dict.fromkeys(("n_steps", "evaluations", "gradients", "failed"), (int, []))
        numbers = dict.fromkeys(("seconds", *cls.statistics), (float, []))
        cls.stats_dtypes_shapes = SMC_KERNEL.stats_dtypes_shapes | counts | numbers

    def __init__(
        self,
        draws: int = 2000,
        *,
        threshold: float = 0.5,
        start: dict | None = None,
        model: pm.Model | None = None,
        random_seed: RandomState = None,
        compile_kwargs: dict | None = None,
        checkpoint: str | PathLike | None = None,
    ):
        # not SMC_KERNEL's own: it would compile two functions for single particles
        self.draws = check_integer(draws, "draws", least=2)
        self.threshold = check_share(threshold, "threshold", "The default is 0.5.")
        self.rng = np.random.default_rng(seed=check_seed(random_seed, states=True))
        compile_kwargs = check_mapping(compile_kwargs, "compile_kwargs", "a dict for `pytensor.function`")
        if checkpoint is not None:
            check_path(checkpoint, "checkpoint")
        model = check_model(model)
        self.variables = model.value_vars
        self.start = None if start is None else checked_start(start, self.variables)
        self.prior = prior_draws(model, self.starts_from_prior)
        # in place of PyMC's initial point, which is compiled anew each time
        draw = self.prior(1, np.random.default_rng(self.rng.integers(2**30)))
        point = {v.name: draw[v.name][0] for v in self.variables}
        self.var_info = {name: (value.shape, value.size) for name, value in point.items()}
        self.n_parameters = sum(size for _, size in self.var_info.values())
        self.compile_evaluation(model, point, compile_kwargs)
        self.checkpoint, self.journal = checkpoint, None
        if checkpoint is not None:
            self.fingerprint = model_fingerprint(model)
            if self.logp.draws_random_numbers:
                raise ValueError(
                    "`checkpoint` must be left out for a model with random draws inside (`noise`), for they "
                    "would not be the same again. Sample it without, or infer the noise by a likelihood."
                )
        self._reset_state()

    def _reset_state(self):
        super()._reset_state()
        self.n_steps = self.evaluations = self.gradients = self.failed = 0
        self.clock = time.perf_counter()

    def checked_stage_draws(self, stage_draws: int | None, share: float, least: int, default: int) -> int:
        """Size of a stage: as asked for, or a share of the draws that suffices for the parameters."""
        if stage_draws is None:
            return max(int(share * self.draws), 50 * self.n_parameters, default)
        return check_integer(stage_draws, "stage_draws", least=least)

    def compile_evaluation(self, model: pm.Model, point: dict, compile_kwargs: dict) -> None:
        """Compile what `evaluate` calls."""
        self.logp = population_logp(model, point, compile_kwargs)

    def evaluate_by(self, spread: Callable[[PopulationLogp], PopulationLogp]) -> None:
        """Let `spread` make of each evaluation the same one elsewhere."""
        for name in self.densities:
            setattr(self, name, spread(getattr(self, name)))

    def set_rng(self, rng: np.random.Generator) -> None:
        """Use this generator; random draws inside the log-probability get streams of their own."""
        self.rng = rng
        self.logp = self.logp.with_rng(rng)
        if self.checkpoint is not None:
            run = {"model": self.fingerprint, "kernel": type(self).__name__, "draws": self.draws}
            if self.journal is not None:
                self.journal.close()  # the chain before
            self.journal = chain_journal(self.checkpoint, run | self.sample_settings(), rng)

    def evaluate(self, particles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log prior and log-likelihood, each (p,), of particles (p, d); counts evaluations and failures."""
        prior, likelihood, failed = evaluated(self.journal, self.logp, particles)
        self.evaluations += len(particles)
        self.failed += int(failed.sum())
        return prior, likelihood

    def evaluate_gradient(self, particles: np.ndarray) -> tuple[np.ndarray, ...]:
        """Log prior and log-likelihood (p,), and the gradients of both (p, d), of particles (p, d).

        Zero gradients where something is not finite. Counts gradients and failures.

        Raises
        ------
        NotDifferentiableError
            If the model has no gradient.
        """
        results = evaluated(self.journal, self.logp.gradient, particles, n_gradients=2)
        prior, likelihood, failed, *slopes = results
        self.gradients += len(particles)
        self.failed += int(failed.sum())
        return prior, likelihood, *slopes

    def initial_particles(self, n: int) -> np.ndarray:
        """The given start, or `n` draws from the prior: (n, d)."""
        # PyMC sets `start` once more, unchecked
        initial = checked_start(self.start, self.variables) if self.start else self.prior(n, self.rng)
        columns = []
        for v in self.variables:
            values = np.array(initial[v.name], dtype=np.float64)
            if self.starts_from_prior and v.dtype in discrete_types:
                values += self.rng.uniform(-0.5, 0.5, values.shape)
            columns.append(values.reshape(len(values), -1))
        return np.hstack(columns)

    def _initialize_kernel(self):
        self.tempered_posterior = self.initial_particles(self.draws)
        self.prior_logp, self.likelihood_logp = self.evaluate(self.tempered_posterior)
        if not (self.prior_logp + self.likelihood_logp > -np.inf).any():
            self.refuse_impossible_model()

    def refuse_impossible_model(self) -> NoReturn:
        """Say that no initial particle is possible."""
        error = f", the last with {self.logp.last_error}" if self.logp.last_error else ""
        raise ValueError(
            f"the model must have a finite log-density somewhere, got none at {self.evaluations} draws from "
            f"the prior ({self.failed} failed simulations{error}). Increase `draws`, narrow the priors, or "
            "check the model at one point with model.point_logps()."
        )

    def propose(self) -> tuple[np.ndarray, np.ndarray | float, np.ndarray | float]:
        """Return proposals (p, d) and the log-densities of the moves back and forth, each (p,) or 0."""
        raise NotImplementedError

    def mutate(self) -> None:
        """Metropolis-Hastings steps until the particles have forgotten where the stage began, as in PyMC."""
        self.n_steps = 0
        previous = 2.0
        start = self.tempered_posterior.copy()
        accepted_steps = []
        while True:
            log_u = np.log(self.rng.random(self.draws))
            proposal, backward, forward = self.propose()
            prior, likelihood = self.evaluate(proposal)
            logp = prior + likelihood * self.beta
            accepted = log_u < (logp + backward) - (self.tempered_posterior_logp + forward)
            self.tempered_posterior[accepted] = proposal[accepted]
            self.tempered_posterior_logp[accepted] = logp[accepted]
            self.prior_logp[accepted] = prior[accepted]
            self.likelihood_logp[accepted] = likelihood[accepted]
            accepted_steps.append(accepted)
            self.n_steps += 1
            r = correlations(start, self.tempered_posterior)
            if not np.mean((previous - r) > self.correlation_threshold) > 0.9:
                break
            previous = r
        self.accepted = np.array(accepted_steps)
        self.accept_rate = float(self.accepted.mean())

    def sample_stats(self) -> dict:
        """Statistics of the stage just finished."""
        now = time.perf_counter()
        stats = {
            "log_marginal_likelihood": self.log_marginal_likelihood if self.beta == 1 else np.nan,
            "beta": self.beta,
            "n_steps": self.n_steps,
            "evaluations": self.evaluations,
            "gradients": self.gradients,
            "failed": self.failed,
            "seconds": now - self.clock,
            **{name: getattr(self, name) for name in self.statistics},
        }
        self.evaluations = self.gradients = self.failed = 0
        self.clock = now
        return stats

    def sample_settings(self) -> dict:
        """Settings, saved as attributes of `sample_stats`."""
        return {"_n_draws": self.draws, **{name: getattr(self, name) for name in self.settings}}


def correlations(a, b) -> np.ndarray:
    """Absolute correlation coefficients (d,) of the columns of two arrays (n, d)."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    return abs((a * b).sum(axis=0)) / np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
