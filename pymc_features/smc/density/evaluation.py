"""Log prior and log-likelihood of a whole population in one call of one compiled function."""

import uuid
import warnings
from contextlib import contextmanager
from weakref import WeakKeyDictionary, WeakValueDictionary

import cloudpickle
import numpy as np
import pytensor.tensor as pt
from pymc.distributions.simulator import SimulatorRV
from pymc.logprob.utils import local_check_parameter_to_ninf_switch, local_remove_check_parameter
from pymc.pytensorf import compile as compile_function
from pymc.pytensorf import join_nonshared_inputs
from pymc.vartypes import discrete_types
from pytensor import shared as make_shared
from pytensor.compile import optdb
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant
from pytensor.graph.fg import FunctionGraph
from pytensor.graph.replace import clone_replace, vectorize_graph
from pytensor.graph.rewriting.basic import dfs_rewriter
from pytensor.graph.rewriting.db import RewriteDatabaseQuery
from pytensor.graph.traversal import ancestors, io_toposort
from pytensor.tensor.random.type import RandomGeneratorType
from pytensor.tensor.type import TensorType

from pymc_features.exceptions import PopulationWarning
from pymc_features.smc.density.nodes import (
    core_op,
    inner_nodes,
    is_random,
    simulator_functions,
    simulators_inside,
    why_not_batched,
)

BATCH_BYTES = 2**26  # of the largest intermediate result of one call; larger populations are split

# what a model function may raise at bad parameters; the particle at fault is then found and set aside
NUMERICAL_ERRORS = (ArithmeticError, np.linalg.LinAlgError)

# In this process, and in those forked from it, a pickled evaluation finds its compiled function here.
_ALIVE: WeakValueDictionary = WeakValueDictionary()
_OF_MODEL: WeakKeyDictionary = WeakKeyDictionary()


@contextmanager
def quiet_about_python():
    """Suppress the warning that a simulator function runs in Python: it always does."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Numba will use object mode", category=UserWarning)
        yield


class PopulationLogp:
    """Log prior and log-likelihood of particles, for any PyMC model.

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
    """

    def __init__(self, model, point, compile_kwargs, terms=None):
        self.token = uuid.uuid4().hex
        self.raised = ""
        outputs, joined, n_failures = joined_graph(model, point, terms or (model.varlogp, model.datalogp))
        self.counts_simulations = n_failures > 0
        self.errors = NUMERICAL_ERRORS if simulator_functions(outputs) == [] else Exception
        self.batch = batch_size(outputs, joined)
        vectorized = None
        if (reason := why_not_batched(outputs)) is None:
            particles = pt.matrix("particles", dtype=joined.dtype)
            try:
                vectorized = vectorize_graph(outputs, {joined: particles})
            except Exception as error:  # any Op of any library may refuse in its own way
                reason = f"a part of the model cannot be vectorised ({error})"
        self.batched = vectorized is not None
        dtype = joined.dtype
        if self.batched:
            rows = particles.shape[0]
            outputs = [out if out.ndim else pt.broadcast_to(out, (rows,)) for out in vectorized]
            joined = particles
        else:
            warnings.warn(f"particles are evaluated one by one: {reason}.", PopulationWarning, stacklevel=2)
        with quiet_about_python():
            self.function = compile_function(
                [joined], outputs, **{**compile_kwargs, "on_unused_input": "ignore"}
            )
        self.function.trust_input = True
        _ALIVE[self.token] = self
        if not self.is_expensive:
            # once in this process, that forked ones need not begin with the machine code
            self(np.concatenate([np.ravel(point[v.name]) for v in model.value_vars])[None].astype(dtype))

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
        size = self.batch if self.batched else 1
        parts = [self._evaluate(particles[i : i + size]) for i in range(0, len(particles), size)]
        prior, likelihood, *failure = (np.concatenate(column) for column in zip(*parts, strict=True))
        failed = failure[0].astype(bool) if self.counts_simulations else ~np.isfinite(likelihood)
        failed |= np.isnan(likelihood) | (likelihood == np.inf)
        failed &= np.isnan(prior) | (prior > -np.inf)
        prior, likelihood = prior.astype(np.float64), likelihood.astype(np.float64)
        prior = np.where(np.isfinite(prior), prior, -np.inf)
        likelihood = np.where(np.isfinite(likelihood), likelihood, -np.inf)
        return prior, likelihood, failed

    def _evaluate(self, particles):
        """Raw outputs, each (p,); NaN for particles at which the model raises a numerical error."""
        try:
            if self.batched:
                return self.function(np.ascontiguousarray(particles))
            return [np.atleast_1d(out) for out in self.function(particles[0])]
        except self.errors as error:
            n = len(particles)
            if n == 1:
                self.raised = f"{type(error).__name__}: {str(error).partition('\n')[0]}"
                n_outputs = 3 if self.counts_simulations else 2
                return [np.full(1, np.nan), np.full(1, np.nan), np.ones(1)][:n_outputs]
            halves = self._evaluate(particles[: n // 2]), self._evaluate(particles[n // 2 :])
            return [np.concatenate(pair) for pair in zip(*halves, strict=True)]

    @property
    def last_error(self) -> str:
        """What the model raised last, or else a simulator function; empty if nothing did."""
        ops = simulators_inside(self.function.maker.fgraph)
        return next(filter(None, [self.raised, *(getattr(op.fn, "last_error", "") for op in ops)]), "")

    @property
    def draws_random_numbers(self) -> bool:
        """Whether two evaluations of the same particle may differ."""
        return any(map(is_random, inner_nodes(self.function.maker.fgraph)))

    @property
    def is_expensive(self) -> bool:
        """Whether something in the model says that it is not to be evaluated more often than need be."""
        nodes = inner_nodes(self.function.maker.fgraph)
        return any(getattr(core_op(node), "expensive", False) for node in nodes)

    def with_rng(self, rng: np.random.Generator) -> "PopulationLogp":
        """An evaluation with random streams of its own; this one if there are no random draws in it."""
        shared = [v for v in self.function.get_shared() if isinstance(v.type, RandomGeneratorType)]
        if not shared:
            return self
        streams = rng.spawn(len(shared))
        swap = {old: make_shared(new, borrow=True) for old, new in zip(shared, streams, strict=True)}
        other = object.__new__(PopulationLogp)
        with quiet_about_python():
            function = self.function.copy(swap=swap)
        other.__dict__.update(self.__dict__, token=uuid.uuid4().hex, function=function)
        other.function.trust_input = True
        return other

    def __getstate__(self):
        return {**self.__dict__, "function": cloudpickle.dumps(self.function)}

    def __setstate__(self, state):
        alive = _ALIVE.get(state["token"])
        function = cloudpickle.loads(state["function"]) if alive is None else alive.function
        self.__dict__.update(state, function=function)
        self.function.trust_input = True


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
    evaluations = _OF_MODEL.setdefault(model, {})
    known = evaluations.get(name)
    if known is None or known[0] != key:
        logp = PopulationLogp(model, point, compile_kwargs, None if terms is None else terms())
        known = evaluations[name] = (key, logp)
    return known[1]


def joined_graph(model, point, terms):
    """Return [log prior, log-likelihood, failed], their one vector input, and how many simulators count.

    Parameter checks become -inf here, before any vectorisation: afterwards one particle outside would take
    all with it.
    """
    outputs = list(terms)
    inputs = model.value_vars
    if any(v.dtype in discrete_types for v in inputs):
        rounded = {}
        floats = []
        for v in inputs:
            if v.dtype in discrete_types:
                float_v = pt.tensor(v.name, dtype="floatX", shape=v.type.shape)
                rounded[v] = pt.round(float_v).astype(v.dtype)
                v = float_v
            floats.append(v)
        outputs, inputs = clone_replace(outputs, rounded, rebuild_strict=False), floats
    graph = FunctionGraph(outputs=outputs, clone=True, copy_inputs=False)
    optdb.query(RewriteDatabaseQuery(include=["fuse_likelihood"])).rewrite(graph)
    check = local_check_parameter_to_ninf_switch if model.check_bounds else local_remove_check_parameter
    dfs_rewriter(check).rewrite(graph)
    outputs = list(graph.outputs)
    failures = [
        pt.any(pt.isnan(out) | pt.isinf(out))
        for node in {v.owner for v in ancestors(outputs) if v.owner is not None}
        if getattr(core_op(node), "simulates", isinstance(node.op, SimulatorRV))
        for out in node.outputs
        if isinstance(out.type, TensorType)
    ]
    if failures:
        failed = failures[0]
        for more in failures[1:]:
            failed = failed | more
        outputs.append(failed)
    joined, vector = join_nonshared_inputs(point, outputs, inputs)
    return joined, vector, len(failures)


def batch_size(outputs, vector) -> int:
    """Particles in one call such that no intermediate result exceeds `BATCH_BYTES`."""
    sources = [
        v
        for v in ancestors(outputs)
        if isinstance(v, Constant | SharedVariable) and isinstance(v.type, TensorType)
    ]
    unknown = 1  # stands for a length that is not known before the call: no longer than the longest data
    for v in sources:
        value = v.data if isinstance(v, Constant) else v.get_value(borrow=True)
        unknown = max([unknown, *np.shape(value)])
    depends = {vector}
    largest = 1
    for node in io_toposort([vector], outputs):
        if depends.isdisjoint(node.inputs):
            continue
        depends.update(node.outputs)
        for v in node.outputs:
            shape = getattr(v.type, "shape", ())
            largest = max(largest, int(np.prod([unknown if n is None else n for n in shape], dtype=float)))
    return max(1, BATCH_BYTES // (8 * largest))
