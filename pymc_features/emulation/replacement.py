"""A PyMC model in which an emulator stands in for an external simulator."""

from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pymc.model.fgraph import fgraph_from_model, model_from_fgraph
from pytensor.graph.replace import graph_replace

from pymc_features._checks import message
from pymc_features.emulation.emulator import PREDICTED_AT_ONCE, Emulator
from pymc_features.external import ExternalSimulator
from pymc_features.inference.parameters import Unconstrained
from pymc_features.ops import ExternalResponse
from pymc_features.smc import Outputs, RowFunction, batched_graph

SAME_RUN = 1e-9  # distance in scaled coordinates within which parameters are those of a run


class StandIn:
    """What the Ops of a model call in place of the simulator: an emulator, which may be replaced by a better.

    Parameters
    ----------
    simulator : ExternalSimulator

    Attributes
    ----------
    emulator : Emulator
    shift : array (component,) or None
        If given, components are taken so many standard deviations off their means, and not as uncertain:
        what the likelihood would be then.
    truly : bool
        Whether runs are looked up in place of predictions; the parameters must be those of runs.
    """

    gradient = True  # there is one

    def __init__(self, simulator):
        self.shape, self.returns, self.dt = simulator.shape, simulator.returns, simulator.dt
        self.identity = simulator.identity
        self.emulator: Emulator | None = None
        self.shift, self.truly = None, False

    @contextmanager
    def shifted(self, shift):
        """For a while, components off their means."""
        self.shift = shift
        try:
            yield
        finally:
            self.shift = None

    @contextmanager
    def true_runs(self):
        """For a while, runs in place of predictions."""
        self.truly = True
        try:
            yield
        finally:
            self.truly = False

    def responses(self, *parameters):
        """Histories (particle, sensor, time), the means; NaN where a run would fail."""
        x, emulator = flat(parameters), self.emulator
        if self.returns == "mean_square":
            raise ValueError("the simulator must return responses for histories, got one of mean squares.")
        if self.truly:
            return emulator.responses[self.runs_at(x)]
        result = np.full((len(x), *self.shape), np.nan)
        good = ~emulator.fails(x)
        if good.any():
            result[good] = emulator.responses_of(self.components(x[good])[0])
        return result

    def discrepancies(self, *parameters, observed=None):
        """Expected e_j (particle, sensor); NaN where a run would fail."""
        x, emulator = flat(parameters), self.emulator
        if self.truly:
            runs = emulator.responses[self.runs_at(x)]
            return runs if observed is None or not emulator.of_histories else squares(runs, observed)
        result = np.full((len(x), self.shape[0]), np.nan)
        good = np.flatnonzero(~emulator.fails(x))
        for first in range(0, len(good), PREDICTED_AT_ONCE):
            rows = good[first : first + PREDICTED_AT_ONCE]
            result[rows] = emulator.discrepancies(*self.components(x[rows]), observed)
        return result

    def components(self, x):
        """Means and variances (n, component), or what they are shifted to."""
        z, variances = self.emulator.predict(x)
        if self.shift is None:
            return z, variances
        return z + self.shift * np.sqrt(variances), np.zeros_like(variances)

    def runs_at(self, x):
        """Numbers of the runs at these parameters (n,)."""
        coordinates = self.emulator.coordinates
        known, points = coordinates(self.emulator.x), coordinates(x)
        off = np.abs(known[None] - points[:, None]).max(axis=2)
        if (off.min(axis=1) > SAME_RUN).any():
            raise ValueError("runs are looked up at their own parameters only.")
        return off.argmin(axis=1)

    def gradients(self, *parameters, cotangent):
        """Gradients of sum(cotangent * result), (sensor, time) for all rows or (row, sensor, time)."""
        x, emulator = flat(parameters), self.emulator
        cotangent = np.asarray(cotangent)
        if self.returns == "mean_square":
            return self.discrepancy_gradients(*parameters, observed=None, weights=np.atleast_2d(cotangent))
        by_mean = np.einsum("...st,cst->...c", cotangent, emulator.basis, optimize=True)
        by_mean = np.broadcast_to(by_mean, (len(x), len(emulator.basis)))
        return unflat(self.finite(x, lambda rows: (by_mean[rows], np.zeros_like(by_mean[rows]))), parameters)

    def finite(self, x, weights_of):
        """Gradients (n, d), zero at parameters that are no numbers."""
        good = np.flatnonzero(np.isfinite(x).all(axis=1))
        result = np.zeros(x.shape)
        if len(good):
            result[good] = self.emulator.slopes(x[good], *weights_of(good))
        return result

    def discrepancy_gradients(self, *parameters, observed, weights):
        """Gradients of sum_j weights_j e_j, weights (row, sensor) or (1, sensor)."""
        x = flat(parameters)
        weights = np.broadcast_to(weights, (len(x), self.shape[0]))
        result = np.zeros(x.shape)
        good = np.flatnonzero(np.isfinite(x).all(axis=1) & np.isfinite(weights).all(axis=1))
        for first in range(0, len(good), PREDICTED_AT_ONCE):
            rows = good[first : first + PREDICTED_AT_ONCE]
            result[rows] = self.emulator.discrepancy_slopes(x[rows], observed, weights[rows])
        return unflat(result, parameters)

    def __deepcopy__(self, memo):
        return self  # copies of a model share the emulator


def squares(runs, observed):
    """Sums of squares over samples that were measured, over the number of all (n, sensor)."""
    misfit = np.where(np.isnan(observed), 0.0, observed - runs)
    return np.where(np.isnan(runs).any(axis=2), np.nan, np.mean(misfit**2, axis=2))


def flat(parameters):
    """Rows (n, d) of parameters with a row for each particle, or one that all share."""
    rows = [np.reshape(p, (len(p), -1)).astype(np.float64) for p in parameters]
    n = max(len(r) for r in rows)
    return np.concatenate([np.broadcast_to(r, (n, r.shape[1])) for r in rows], axis=1)


def unflat(gradient, parameters):
    """Gradients (n, d) as one array for each parameter."""
    sizes = [int(np.prod(np.shape(p)[1:])) for p in parameters]
    parts = np.split(gradient, np.cumsum(sizes)[:-1], axis=1)
    return [part.reshape(-1, *np.shape(p)[1:]) for part, p in zip(parts, parameters, strict=True)]


class Replacement(NamedTuple):
    """A model and its copy with a stand-in.

    Attributes
    ----------
    simulator : ExternalSimulator
    stand_in : StandIn
    model : pymc.Model
        The copy.
    parameters_of : callable
        Points theta (n, d) on the unconstrained scale to the arguments of the simulator, a list of arrays with
        rows.
    """

    simulator: ExternalSimulator
    stand_in: StandIn
    model: pm.Model
    parameters_of: object


def replaced(model: pm.Model) -> Replacement:
    """Put a stand-in in the place of the one external simulator of a model.

    Raises
    ------
    ValueError
        If there is none, or more than one response of one.
    """
    fgraph, _ = fgraph_from_model(model)
    nodes = [node for node in fgraph.apply_nodes if isinstance(node.op, ExternalResponse)]
    if len(nodes) != 1:
        advice = "Use the simulator once, as mu of a likelihood."
        expected = "one response of an ExternalSimulator"
        raise ValueError(message("model", expected, str(len(nodes) or "none"), advice))
    [node] = nodes
    if not isinstance(node.op.simulator, ExternalSimulator):
        raise ValueError(message("model", "that of the simulator", "one with an emulator already"))
    stand_in = StandIn(node.op.simulator)
    response = ExternalResponse(stand_in, node.op.ndims)(*node.inputs)
    fgraph.replace(node.outputs[0], response, reason="emulate", import_missing=True)
    copy = model_from_fgraph(fgraph, mutate_fgraph=True)
    return Replacement(node.op.simulator, stand_in, copy, arguments(copy, stand_in))


def arguments(model, stand_in):
    """The function from points theta (n, d) to the arguments of the simulator."""
    outputs = [*model.basic_RVs, *model.potentials, *model.deterministics]
    [node] = {
        v.owner
        for v in ancestors_of(outputs)
        if v.owner is not None
        and isinstance(v.owner.op, ExternalResponse)
        and v.owner.op.simulator is stand_in
    }
    space = Unconstrained(model)
    theta, values, first = pt.vector("theta"), {}, 0
    for v in model.value_vars:
        size = int(np.prod(space.shapes[v.name], dtype=int))
        values[v] = theta[first : first + size].reshape(space.shapes[v.name]).astype(v.dtype)
        values[v] = pt.specify_shape(values[v], v.type.shape)
        first += size
    inputs = graph_replace(model.replace_rvs_by_values(node.inputs), values, strict=False)
    shapes = [tuple(value.shape) for value in inputs_at(model, node)]
    row = pt.concatenate([x.ravel() for x in inputs])
    function = RowFunction(batched_graph(Outputs(theta, [row])), {})
    sizes = np.cumsum([int(np.prod(shape, dtype=int)) for shape in shapes])[:-1]

    def parameters_of(points):
        [rows] = function(points)
        parts = np.split(rows, sizes, axis=1)
        return [part.reshape(len(points), *shape) for part, shape in zip(parts, shapes, strict=True)]

    return parameters_of


def ancestors_of(outputs):
    """All variables that some depend on."""
    from pytensor.graph.traversal import ancestors

    return ancestors(outputs)


def inputs_at(model, node):
    """Arguments of the simulator at the initial point, for their shapes."""
    tensors = model.replace_rvs_by_values(node.inputs)
    function = model.compile_fn(
        tensors, inputs=model.value_vars, mode="FAST_COMPILE", on_unused_input="ignore"
    )
    return function(model.initial_point())
