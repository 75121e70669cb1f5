"""Log prior and log-likelihood of a whole population in one call of one compiled function."""

import uuid
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from weakref import WeakValueDictionary

import cloudpickle
import numpy as np
import pytensor.tensor as pt
from pymc.vartypes import discrete_types
from pytensor.gradient import NullTypeGradError

from pymc_features.exceptions import NotDifferentiableError, PopulationWarning
from pymc_features.smc.density.graph import (
    DensityGraph,
    Outputs,
    batched_graph,
    core_op,
    inner_nodes,
    is_random,
    joined_graph,
    simulator_functions,
)
from pymc_features.smc.density.prior import inside_support, kept_for, prior_points
from pymc_features.smc.density.rows import RowFunction


def gradient_graph(graph: DensityGraph) -> DensityGraph:
    """Add the gradients of log prior and log-likelihood, (d,) or (p, d), behind the outputs of a graph.

    Raises
    ------
    NotDifferentiableError
        If a part of the model has no gradient; the message is one sentence without its stop.
    """
    try:
        one = with_gradients(graph.one)
    except Exception as error:  # any Op of any library may refuse in its own way
        raise NotDifferentiableError(reason_of(error)) from error
    if graph.population is None:
        return graph._replace(one=one)
    try:
        return graph._replace(one=one, population=with_gradients(graph.population))
    except Exception as error:
        reason = f"a part of the model has no gradient of a population ({reason_of(error)})"
        return graph._replace(one=one, population=None, why_not_batched=reason)


def with_gradients(graph: Outputs) -> Outputs:
    """Add the gradients: those of sums over particles, for no row depends on another."""
    prior, likelihood, *_ = graph.outputs
    slopes = [
        pt.grad(density.astype("float64").sum(), graph.joined, disconnected_inputs="ignore")
        for density in (prior, likelihood)
    ]
    return graph._replace(outputs=[*graph.outputs, *slopes])


def reason_of(error: Exception) -> str:
    """First sentence of what an error says; of PyTensor's on a missing gradient, that which names the Op."""
    said = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, NullTypeGradError):
        said = said.rpartition(" because ")[2]
    return said.partition(". ")[0].removesuffix(".")


PRIOR_POINTS = 1024  # at most, from which bases are made

# In this process, and in those forked from it, a pickled evaluation finds its compiled functions here.
_ALIVE: WeakValueDictionary = WeakValueDictionary()


class PopulationLogp:
    """Log prior and log-likelihood of particles, and their gradients, for any PyMC model.

    Parameters
    ----------
    model : pymc.Model
    point : dict
        An initial point of the model, for the shapes of its variables.
    compile_kwargs : dict
        For `pytensor.function`.
    terms : tuple of two scalar tensors, optional
        What to evaluate instead, in the model's value variables.

    Attributes
    ----------
    batched : bool
        False if the particles are evaluated one by one, since a part of the model takes no batch.
    all_over : array (n, d) or None
        Particles from the prior, for the bases of large sparse structures; always the same ones.
    spread : callable or None
        What evaluates populations elsewhere, see `spread_over`.
    """

    def __init__(self, model, point, compile_kwargs, terms=None):
        self.token = uuid.uuid4().hex
        self.compile_kwargs = dict(compile_kwargs)
        terms = inside_support(model, point, terms or (model.varlogp, model.datalogp))
        self.graph = batched_graph(joined_graph(model, point, *terms))
        self.discrete = [v.name for v in model.value_vars if v.dtype in discrete_types]
        self.counts_simulations = self.graph.counts_simulations
        if self.graph.why_not_batched:
            warnings.warn(
                f"particles are evaluated one by one: {self.graph.why_not_batched}.",
                PopulationWarning,
                stacklevel=2,
            )
        self.spread = None
        self.values = RowFunction(self.graph, self.compile_kwargs)
        self.slopes = self._with_slopes = None  # not known before they are asked for
        _ALIVE[self.token] = self
        start = np.concatenate([np.ravel(point[v.name]) for v in model.value_vars])[None]
        self.start = start.astype(self.graph.one.joined.dtype)
        self.all_over = None
        # in this process, that forked ones need not begin with the machine code
        if not self.is_expensive and self.values.has_large_structures(self.start):
            with suppress(NotImplementedError):  # of a prior without draws
                self.all_over = prior_points(model, PRIOR_POINTS, np.random.default_rng(0))
                self.values.learn(self.all_over)

    def __call__(self, particles: np.ndarray):
        """Evaluate particles (p, d).

        Returns
        -------
        log_prior, log_likelihood : array (p,)
            -inf where they are not finite numbers.
        failed : array of bool (p,)
            Particles inside the prior's support whose simulation failed: where the model has a simulator of
            ours, its result is not finite; elsewhere, the log-likelihood is not. Those at which the model
            raises a numerical error, too.
        """
        return self._judge(*self._outputs("values", particles))

    def _outputs(self, which, particles):
        """Raw outputs of `values` or `slopes`, here or on the workers."""
        if self.spread is None:
            return getattr(self, which)(particles)
        return self.spread(self, which, particles)

    def _judge(self, prior, likelihood, *failure):
        """Log prior, log-likelihood and failures, from the raw outputs, each (p,)."""
        failed = failure[0].astype(bool) if self.counts_simulations else ~np.isfinite(likelihood)
        failed |= np.isnan(likelihood) | (likelihood == np.inf)
        failed &= np.isnan(prior) | (prior > -np.inf)
        prior, likelihood = prior.astype(np.float64), likelihood.astype(np.float64)
        prior = np.where(np.isfinite(prior), prior, -np.inf)
        likelihood = np.where(np.isfinite(likelihood), likelihood, -np.inf)
        return prior, likelihood, failed

    def gradient(self, particles: np.ndarray):
        """Evaluate particles (p, d) and their gradients, by a second function that is compiled on first use.

        Returns
        -------
        log_prior, log_likelihood, failed : array (p,)
            As from a call; particles at which the gradient raises a numerical error have failed, too.
        grad_prior, grad_likelihood : array (p, d)
            Both zero in the rows of particles where a log-density, or any entry of these, is not finite.

        Raises
        ------
        NotDifferentiableError
            If the model has no gradient, see `why_no_gradient`.

        Notes
        -----
        Memory: of models whose comparison with the data is fused, a few blocks of 128 samples, as for the
        values (tests/smc/test_population_gradient.py); of others, batches of a third of the size.
        """
        if self.slopes is None:
            self.compile_gradient()
        *values, grad_prior, grad_likelihood = self._outputs("slopes", particles)
        prior, likelihood, failed = self._judge(*values)
        slopes = np.stack([grad_prior, grad_likelihood], dtype=np.float64)
        slopes[:, ~(np.isfinite(prior + likelihood) & np.isfinite(slopes).all(axis=(0, 2)))] = 0.0
        return prior, likelihood, failed, *slopes

    def compile_gradient(self) -> None:
        """Compile the function of `gradient`, if it is not: once before a fork, that no process need do it.

        Raises
        ------
        NotDifferentiableError
            If the model has no gradient, see `why_no_gradient`.
        """
        owner = _ALIVE.get(self.token, self)  # where the next copy looks
        if owner.slopes is None:
            if owner.why_no_gradient:
                raise NotDifferentiableError(
                    f"the model has no gradient: {owner.why_no_gradient}. Use a kernel that needs none."
                )
            # a result, its cotangent and that of what it came from
            graph = owner._with_slopes or gradient_graph(owner.graph)
            owner.slopes = RowFunction(graph, owner.compile_kwargs, alive=3)
            owner._with_slopes = None
            if not owner.is_expensive:
                owner.slopes(owner.start)
            if owner.all_over is not None:
                owner.slopes.learn(owner.all_over)
        self.slopes, self.why_no_gradient = owner.slopes, ""

    @cached_property
    def why_no_gradient(self) -> str:
        """What part of the model has no gradient; empty if there is one. Compiles nothing."""
        if self.discrete:
            return f"{', '.join(self.discrete)} is discrete"
        try:
            self._with_slopes = gradient_graph(self.graph)
        except NotDifferentiableError as error:
            return str(error)
        return "random numbers are drawn inside, anew in each call" if self.draws_random_numbers else ""

    @property
    def has_gradient(self) -> bool:
        """Whether `gradient` can be called."""
        return not self.why_no_gradient

    @property
    def nodes(self) -> list:
        """Nodes of the compiled function of the values."""
        return list(inner_nodes(self.values.function.maker.fgraph))

    @property
    def batched(self) -> bool:
        """Whether all particles are evaluated in one call."""
        return self.values.batched

    @property
    def last_error(self) -> str:
        """What the model raised last, or else a simulator function; empty if nothing did."""
        ops = simulator_functions(self.nodes)
        raised = [f.raised for f in (self.values, self.slopes) if f is not None]
        return next(filter(None, [*raised, *(getattr(op.fn, "last_error", "") for op in ops)]), "")

    @property
    def draws_random_numbers(self) -> bool:
        """Whether two evaluations of the same particle may differ."""
        return any(map(is_random, self.nodes))

    @property
    def is_expensive(self) -> bool:
        """Whether something in the model says that it is not to be evaluated more often than need be."""
        return any(getattr(core_op(node), "expensive", False) for node in self.nodes)

    def spread_over(self, spread: Callable) -> "PopulationLogp":
        """Evaluate by `spread(logp, "values" or "slopes", particles)`."""
        other = object.__new__(PopulationLogp)
        other.__dict__.update(self.__dict__, spread=spread)
        return other

    def with_rng(self, rng: np.random.Generator) -> "PopulationLogp":
        """An evaluation with random streams of its own; this one if there are no random draws in it."""
        values = self.values.with_rng(rng)
        if values is self.values:
            return self
        other = object.__new__(PopulationLogp)
        other.__dict__.update(self.__dict__, token=uuid.uuid4().hex, values=values)
        return other

    def __getstate__(self):
        # together, that what they share is written once; the graph only where it may still be compiled
        graph = self.graph if self.slopes is None else None
        parts = cloudpickle.dumps((self.values, self.slopes, graph))
        others = {k: v for k, v in self.__dict__.items() if k not in PARTS}
        return others | {"_with_slopes": None, "spread": None, "parts": parts}

    def __setstate__(self, state):
        parts = state.pop("parts")
        alive = _ALIVE.get(state["token"])
        found = cloudpickle.loads(parts) if alive is None else [getattr(alive, name) for name in PARTS]
        self.__dict__.update(state, **dict(zip(PARTS, found, strict=True)))


PARTS = ("values", "slopes", "graph")  # of an evaluation: what is compiled, or can be


def population_logp(model, point, compile_kwargs, name="posterior", terms=None) -> PopulationLogp:
    """The model's evaluation, compiled the first time it is asked for.

    New values of `pm.Data` need no new one; a model with other variables, potentials or shapes does. `name`
    tells evaluations of different `terms` of a model apart; `terms` is a function that returns them.
    """
    key = (
        tuple(id(v) for v in (*model.value_vars, *model.potentials, *model.observed_RVs)),
        tuple(id(model.rvs_to_values[v]) for v in model.observed_RVs),
        tuple((name, np.shape(value)) for name, value in point.items()),
        model.check_bounds,
        repr(sorted(compile_kwargs.items())),
    )

    def make():
        return PopulationLogp(model, point, compile_kwargs, None if terms is None else terms())

    return kept_for(model, f"density {name}", key, make)
