"""Modes as a simulator: matched with identified ones, squared errors of ln f and 1 - MAC as mean squares."""

import numpy as np
import pytensor.tensor as pt
from scipy.optimize import linear_sum_assignment

from pymc_features.likelihood_free.functions import number, simulate_batch, spread_batch
from pymc_features.modal_features import SymbolicModes, mac
from pymc_features.modal_features.assignment import Assignment
from pymc_features.modal_features.identified import Identified
from pymc_features.modal_features.mac import one_minus_mac
from pymc_features.modal_features.operations import StructuralModes

FAR = 1e30  # stands for an infinite distance in sums of which the smallest is wanted


class ModesSimulator:
    """Simulator function of modes, `fn(rng, *parameters, size)`: those that are matched, in one array.

    Parameters
    ----------
    node : Apply
        Of a `StructuralModes`.
    data : Identified

    Attributes
    ----------
    epsilon : TensorVariable () or (entry,)
        Tolerance, by which errors of frequencies and shapes are weighed in the assignment.
    with_shape : bool array (i,)
        Identifications that have a shape: entries are all frequencies, then these.
    """

    draws_random_numbers = False

    def __init__(self, node, data: Identified):
        self.op, n = node.op, node.op.n_parameters
        self.parameters, self.settings = node.inputs[:n], node.inputs[n:]
        self.ndims_params = self.op.ndims[:n]
        self.data = data
        self.epsilon = pt.ones(())
        self.with_shape = data.known.any(axis=1)

    @property
    def n_entries(self) -> int:
        """Number of squared errors."""
        return self.with_shape.size + int(self.with_shape.sum())

    def weights(self, epsilon):
        """1 / epsilon of each identification's frequency and shape, (2, i); zero without a shape."""
        n = self.with_shape.size
        places = np.zeros((2, n, self.n_entries))
        places[0, np.arange(n), np.arange(n)] = 1.0
        places[1, np.flatnonzero(self.with_shape), np.arange(n, self.n_entries)] = 1.0
        return (places / epsilon).sum(axis=-1)

    def core(self, *parameters):
        """Values (i, c) of one set of parameters, shapes scaled such that they fit best."""
        settings = (np.asarray(number(value)) for value in self.settings)
        frequencies, shapes, _ = self.op.run(
            [*(np.asarray(p, dtype=np.float64) for p in parameters), *settings]
        )
        data = self.data
        if not np.isfinite(frequencies).all():
            return np.full(data.values.shape, np.nan)
        with np.errstate(divide="ignore"):
            errors = np.square(np.log(data.frequencies)[:, None] - np.log(frequencies))
        shapes = shapes if data.shapes.size else np.empty((len(shapes), 0))
        distances = np.zeros(errors.shape)
        measured = np.where(data.known > 0, data.shapes, np.nan)
        distances[self.with_shape] = 1.0 - mac(measured, shapes)[self.with_shape]
        weights = self.weights(number(self.epsilon))[:, :, None]
        cost = data.groups @ np.minimum(weights[0] * errors + weights[1] * distances, FAR)
        r = linear_sum_assignment(cost)[1][data.groups.argmax(axis=0)]
        fitted = shapes[r] * data.known
        squares = np.sum(fitted**2, axis=1, keepdims=True)
        scale = np.sum(fitted * data.shapes, axis=1, keepdims=True) / np.where(squares > 0.0, squares, 1.0)
        return data._replace(frequencies=frequencies[r], shapes=scale * fitted).values

    def __call__(self, rng, *parameters_and_size):
        *parameters, size = parameters_and_size
        return simulate_batch(self.core, *spread_batch(parameters, self.ndims_params, size))

    def discrepancy(self, parameters, value):
        """Squared errors (entry,), a tensor: (ln f^ - ln f)^2 of each, then 1 - MAC of those with a shape."""
        frequencies, shapes, _ = self.op(*parameters, *self.settings)
        data = self.data
        errors = pt.sqr(pt.log(value[:, 0])[:, None] - pt.log(frequencies))
        s = data.shapes.shape[1]
        parts = [value[:, 1 + i * s : 1 + (i + 1) * s] for i in range(1 + data.is_complex)]
        known = pt.as_tensor_variable(data.known)
        distances = one_minus_mac(shapes, parts, known) if s else pt.zeros_like(errors)
        epsilon = pt.broadcast_to(self.epsilon, (self.n_entries,))
        weights = self.weights(epsilon)[:, :, None]
        cost = pt.matmul(data.groups, pt.minimum(weights[0] * errors + weights[1] * distances, FAR))
        chosen = pt.matmul(data.groups.T, Assignment()(-cost)) > 0.5
        taken = [pt.sum(pt.switch(chosen, e, 0.0), axis=-1) for e in (errors, distances)]
        return pt.concatenate([taken[0], taken[1][np.flatnonzero(self.with_shape)]])


def node_of(mu: SymbolicModes, data: Identified):
    """The node of modes that come from `modes`, at the channels of the data."""
    node = mu.frequencies.owner
    if node is None or not isinstance(node.op, StructuralModes) or mu.shapes.owner is not node:
        raise TypeError(
            "`mu` must be what `modes` returned, at `sensors`, got other expressions. Pass a function of the "
            "parameters instead."
        )
    (m, s), wanted = node.outputs[1].type.shape, data.shapes.shape[1]
    if wanted and s not in (None, wanted):
        raise ValueError(
            f"`observed` must have shapes at the {s} sensors of `modes`, got {wanted} channels. Pass those "
            "of the data as `sensors`."
        )
    if m is not None and m < len(data.labels):
        raise ValueError(
            f"`modes` must have at least as many modes as were identified, {len(data.labels)}, got {m}. Ask "
            "`modes` for more."
        )
    return node
