"""A PyMC model in which emulators stand in for external simulators."""

from collections.abc import Callable
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pymc.model.fgraph import fgraph_from_model, model_from_fgraph
from pytensor.graph.basic import Variable
from pytensor.graph.replace import graph_replace
from pytensor.graph.traversal import ancestors

from pymc_features._checks import message
from pymc_features.external.emulator import PREDICTED_AT_ONCE, Emulator
from pymc_features.external.simulator import ExternalSimulator, unflat
from pymc_features.fingerprint import fingerprint
from pymc_features.inference.parameters import Unconstrained
from pymc_features.ops import ExternalResponse
from pymc_features.ops.declared import values_at_start
from pymc_features.smc import Outputs, RowFunction, batched_graph

SAME_RUN = 1e-9  # distance in scaled coordinates within which parameters are those of a run


class StandIn:
    """Stands in for the simulator in the Ops of a model: an emulator, which may be replaced by a better.

    With a `shift` (component,) components are taken so many standard deviations off their means, and not as
    uncertain: what the likelihood would be then. Where `truly` is set, runs are looked up in place of
    predictions, at the parameters of runs only.
    """

    gradient = True  # there is one

    def __init__(self, simulator):
        self.shape, self.returns, self.dt = simulator.shape, simulator.returns, simulator.dt
        self.simulator_identity = simulator.identity
        self.emulator: Emulator | None = None
        self.shift, self.truly = None, False

    @property
    def identity(self) -> str:
        """Fingerprint of what is computed, for checkpoints."""
        runs = () if self.emulator is None else (self.emulator.x, self.emulator.responses)
        return fingerprint(self.simulator_identity, *runs)

    @contextmanager
    def taken(self, *, shift=None, truly=False):
        """For a while, components off their means, or runs in place of predictions."""
        self.shift, self.truly = shift, truly
        try:
            yield
        finally:
            self.shift, self.truly = None, False

    def responses(self, *parameters):
        """Histories (particle, sensor, time), the means; NaN where a run would fail."""
        x, emulator = flat(parameters), self.emulator
        if self.returns == "mean_square":
            raise ValueError("the simulator must return responses for histories, got one of mean squares.")
        if self.truly:
            return emulator.responses[self.runs_at(x)]
        result = np.full((len(x), *self.shape), np.nan)
        for rows in some_at_once(~emulator.fails(x)):
            result[rows] = emulator.responses_of(self.components(x[rows])[0])
        return result

    def discrepancies(self, *parameters, observed=None):
        """Expected e_j (particle, sensor); NaN where a run would fail."""
        x, emulator = flat(parameters), self.emulator
        if self.truly:
            runs = emulator.responses[self.runs_at(x)]
            return runs if observed is None or not emulator.of_histories else squares(runs, observed)
        result = np.full((len(x), self.shape[0]), np.nan)
        for rows in some_at_once(~emulator.fails(x)):
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
        by_mean, result = np.broadcast_to(by_mean, (len(x), len(emulator.basis))), np.zeros(x.shape)
        for rows in some_at_once(np.isfinite(x).all(axis=1)):
            result[rows] = emulator.slopes(x[rows], by_mean[rows], np.zeros_like(by_mean[rows]))
        return unflat(result, parameters)

    def discrepancy_gradients(self, *parameters, observed, weights):
        """Gradients of sum_j weights_j e_j, weights (row, sensor) or (1, sensor)."""
        x = flat(parameters)
        weights, result = np.broadcast_to(weights, (len(x), self.shape[0])), np.zeros(x.shape)
        for rows in some_at_once(np.isfinite(x).all(axis=1) & np.isfinite(weights).all(axis=1)):
            result[rows] = self.emulator.discrepancy_slopes(x[rows], observed, weights[rows])
        return unflat(result, parameters)

    def __deepcopy__(self, memo):
        return self  # copies of a model share the emulator


def some_at_once(good):
    """Numbers of good rows, in parts that fit into memory."""
    rows = np.flatnonzero(good)
    return (rows[i : i + PREDICTED_AT_ONCE] for i in range(0, rows.size, PREDICTED_AT_ONCE))


def squares(runs, observed):
    """Sums of squares over samples that were measured, over the number of all (n, sensor)."""
    misfit = np.where(np.isnan(observed), 0.0, observed - runs)
    return np.where(np.isnan(runs).any(axis=2), np.nan, np.mean(misfit**2, axis=2))


def flat(parameters):
    """Rows (n, d) of parameters with a row for each particle, or one that all share."""
    rows = [np.reshape(p, (len(p), -1)).astype(np.float64) for p in parameters]
    n = max(len(r) for r in rows)
    return np.concatenate([np.broadcast_to(r, (n, r.shape[1])) for r in rows], axis=1)


class Part(NamedTuple):
    """One response in a model; `parameters_of` turns points theta (n, d) into arguments with rows."""

    simulator: ExternalSimulator
    stand_in: StandIn
    parameters_of: Callable


def replaced(model: pm.Model) -> tuple[pm.Model, list[Part]]:
    """A copy of a model with stand-ins in the place of its external simulators."""
    initial = dict(model.rvs_to_initial_values)
    model.rvs_to_initial_values.update(dict.fromkeys(initial))  # PyMC copies no model that has some
    try:
        fgraph, _ = fgraph_from_model(model)
    finally:
        model.rvs_to_initial_values.update(initial)
    nodes = [node for node in fgraph.apply_nodes if isinstance(node.op, ExternalResponse)]
    if not nodes:
        advice = "Write mu=simulator(...) in a likelihood; for a DiscrepancySimulator there is no emulator."
        raise ValueError(message("model", "a model with a response of an ExternalSimulator", "none", advice))
    if not all(isinstance(node.op.simulator, ExternalSimulator) for node in nodes):
        raise ValueError(message("model", "that of the simulator", "one that emulate() has made"))
    stand_ins = []
    for node in nodes:
        stand_ins.append((node.op.simulator, StandIn(node.op.simulator)))
        response = ExternalResponse(stand_ins[-1][1], node.op.ndims)(*node.inputs)
        fgraph.replace(node.outputs[0], response, reason="emulate", import_missing=True)
    copy = model_from_fgraph(fgraph, mutate_fgraph=True)
    order = [rv.name for rv in model.basic_RVs]
    for variables in (copy.free_RVs, copy.observed_RVs):  # as in the model, not as in its graph
        variables.sort(key=lambda rv: order.index(rv.name))
    for rv, value in initial.items():
        copy.rvs_to_initial_values[copy[rv.name]] = None if isinstance(value, Variable) else value
    return copy, [Part(*pair, arguments(copy, pair[1])) for pair in stand_ins]


def arguments(model, stand_in) -> Callable:
    """The function from points theta (n, d) to the arguments of a simulator."""
    [node] = {
        v.owner
        for v in ancestors([*model.basic_RVs, *model.potentials, *model.deterministics])
        if isinstance(getattr(v.owner, "op", None), ExternalResponse) and v.owner.op.simulator is stand_in
    }
    space, theta = Unconstrained(model), pt.vector("theta")
    tensors = model.replace_rvs_by_values(node.inputs)
    parts = space.split(theta)
    values = {v: pt.specify_shape(parts[v.name].astype(v.dtype), v.type.shape) for v in model.value_vars}
    inputs = graph_replace(tensors, values, strict=False)
    shapes = [np.shape(value) for value in values_at_start(node.inputs, model)]
    function = RowFunction(batched_graph(Outputs(theta, [pt.concatenate([x.ravel() for x in inputs])])), {})
    ends = np.cumsum([int(np.prod(shape, dtype=int)) for shape in shapes])[:-1]

    def parameters_of(points):
        [rows] = function(points)
        parts = np.split(rows, ends, axis=1)
        return [part.reshape(len(points), *shape) for part, shape in zip(parts, shapes, strict=True)]

    return parameters_of
