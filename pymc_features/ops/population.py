"""The fused discrepancy of a whole population, and how vectorised graphs come to use it."""

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import disconnected_type, grad_undefined
from pytensor.graph.basic import Apply
from pytensor.graph.replace import _vectorize_node
from pytensor.tensor.blockwise import Blockwise

from pymc_features.ops.base import INPUTS, N_PARAMETERS, ChainOp
from pymc_features.ops.discrepancy import ChainDiscrepancy
from pymc_features.ops.gradient import PopulationGradient
from pymc_features.simulators import population_discrepancy


class PopulationDiscrepancy(ChainOp):
    """e_j of Eq. (3) for a population: mass, stiffness, rayleigh and ratios have one row for each particle.

    A parameter that all particles share has a single row. The result is (particle, sensor); no history of
    any particle is stored.
    """

    simulates = True

    def make_node(self, *inputs):
        *common, observed = inputs
        parameters = [pt.as_tensor_variable(x).astype("float64") for x in common[:N_PARAMETERS]]
        for name, parameter in zip(INPUTS, parameters, strict=False):
            if parameter.ndim != 2:
                raise ValueError(f"`{name}` must be (particle, entry), got {parameter.ndim} dimensions.")
        rest = self.prepare_inputs(common[N_PARAMETERS:], start=N_PARAMETERS)
        observed = pt.as_tensor_variable(observed).astype("float64")
        if observed.ndim != 2:
            raise ValueError(f"`observed` must be (sensor, time), got {observed.ndim} dimensions.")
        sensors = rest[8 - N_PARAMETERS]
        output = pt.tensor(dtype="float64", shape=(None, sensors.type.shape[0]))
        return Apply(self, [*parameters, *rest, observed], [output])

    def infer_shape(self, node, shapes):
        rows = shapes[0][0]
        for shape in shapes[1:N_PARAMETERS]:
            rows = pt.maximum(rows, shape[0])
        return [(rows, shapes[8][0])]

    def perform(self, node, inputs, output_storage):
        *common, observed = [np.ascontiguousarray(x) if np.ndim(x) else x.item() for x in inputs]
        output_storage[0][0] = population_discrepancy(*common, self.quantity_code, observed)

    def pullback(self, inputs, outputs, cotangents):
        """By `PopulationGradient`; the data of a population are not differentiated."""
        return [
            *PopulationGradient(self.quantity)(*inputs, *cotangents),
            *(disconnected_type() for _ in inputs[N_PARAMETERS:-1]),
            grad_undefined(self, len(inputs) - 1, inputs[-1], "Differentiate one particle, or the response."),
        ]


def fused_discrepancy(quantity, inputs):
    """Discrepancy (..., sensor) for inputs of which any may have leading batch dimensions.

    Batches of parameters alone become one `PopulationDiscrepancy`; others are left to `Blockwise`.
    """
    expected = [*INPUTS.values(), 2]
    inputs = [without_unit_batch(x, ndim) for x, ndim in zip(inputs, expected, strict=True)]
    parameters, rest = inputs[:N_PARAMETERS], inputs[N_PARAMETERS:]
    if any(x.type.ndim != ndim for x, ndim in zip(rest, expected[N_PARAMETERS:], strict=True)):
        return Blockwise(ChainDiscrepancy(quantity))(*inputs)
    depth = max(x.type.ndim - 1 for x in parameters)
    if depth == 0:
        return ChainDiscrepancy(quantity)(*inputs)
    if depth > 1:
        batched = [x for x in parameters if x.type.ndim > 1]
        batch = pt.broadcast_shape(*(tuple(x.shape)[:-1] for x in batched), arrays_are_shapes=True)
        parameters = [
            pt.broadcast_to(x, (*batch, x.shape[-1])).reshape((-1, x.shape[-1])) if x.type.ndim > 1 else x
            for x in parameters
        ]
    rows = [x[None] if x.type.ndim == 1 else x for x in parameters]
    e = PopulationDiscrepancy(quantity)(*rows, *rest)
    return e if depth == 1 else e.reshape((*batch, e.shape[-1]), ndim=depth + 1)


def without_unit_batch(x, ndim):
    """Drop leading dimensions beyond `ndim` that have length one by their type, as `Blockwise` adds them."""
    extra = x.type.ndim - ndim
    if extra > 0 and all(x.type.broadcastable[:extra]):
        return x.dimshuffle(*range(extra, x.type.ndim))
    return x


@_vectorize_node.register(ChainDiscrepancy)
def vectorize_discrepancy(op, node, *batched_inputs):
    """Batches of parameters become the population Op."""
    return [fused_discrepancy(op.quantity, batched_inputs)]
