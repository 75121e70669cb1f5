"""The fused comparisons of a whole population, and how vectorised graphs come to use them."""

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import disconnected_type, grad_undefined
from pytensor.graph.basic import Apply
from pytensor.graph.replace import _vectorize_node
from pytensor.tensor.blockwise import Blockwise

from pymc_features.ops.base import INPUTS, N_PARAMETERS, ChainOp
from pymc_features.ops.discrepancy import ChainComparison, ChainDiscrepancy
from pymc_features.ops.gradient import ChainResponseGradient, PopulationGradient
from pymc_features.ops.misfit import ChainMisfit, misfit_cotangent
from pymc_features.ops.response import ChainResponse
from pymc_features.simulators import population_discrepancy, population_misfit


class PopulationComparison(ChainOp):
    """Base: as `ChainComparison`, where mass, stiffness, rayleigh and ratios have a row for each particle.

    A parameter that all particles share has a single row. The result is (particle, sensor, *values).
    """

    kernel = None
    values: tuple[int, ...] = ()
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
        output = pt.tensor(dtype="float64", shape=(None, sensors.type.shape[0], *self.values))
        return Apply(self, [*parameters, *rest, observed], [output])

    def infer_shape(self, node, shapes):
        rows = shapes[0][0]
        for shape in shapes[1:N_PARAMETERS]:
            rows = pt.maximum(rows, shape[0])
        return [(rows, shapes[8][0], *self.values)]

    def perform(self, node, inputs, output_storage):
        *common, observed = [np.ascontiguousarray(x) if np.ndim(x) else x.item() for x in inputs]
        output_storage[0][0] = type(self).kernel(*common, self.quantity_code, observed)


class PopulationDiscrepancy(PopulationComparison):
    """e_j of Eq. (3) for a population (particle, sensor); no history of any particle is stored."""

    kernel = staticmethod(population_discrepancy)

    def pullback(self, inputs, outputs, cotangents):
        """By `PopulationGradient`; the data of a population are not differentiated."""
        return [
            *PopulationGradient(self.quantity)(*inputs, *cotangents),
            *(disconnected_type() for _ in inputs[N_PARAMETERS:-1]),
            grad_undefined(self, len(inputs) - 1, inputs[-1], "Differentiate one particle, or the response."),
        ]


class PopulationMisfit(PopulationComparison):
    """Statistics of the misfit (particle, sensor, 4), as `ChainMisfit`; no history is stored."""

    kernel = staticmethod(population_misfit)
    values = (4,)

    def pullback(self, inputs, outputs, cotangents):
        """From the responses of all particles, which are stored for this: (particle, sensor, time)."""
        parameters, settings, observed = inputs[:N_PARAMETERS], inputs[N_PARAMETERS:-1], inputs[-1]
        n_particles = outputs[0].shape[0]
        rows = [pt.broadcast_to(x, (n_particles, x.shape[1])) for x in parameters]
        responses = Blockwise(ChainResponse(self.quantity))(*rows, *settings)
        by_misfit = misfit_cotangent(observed - responses, *cotangents)
        gradients = Blockwise(ChainResponseGradient(self.quantity))(*rows, *settings, -by_misfit)
        return [
            # what all particles share gets the sum
            *(
                g.reshape((n_particles // x.shape[0], *x.shape)).sum(axis=0)
                for g, x in zip(gradients, parameters, strict=True)
            ),
            *(disconnected_type() for _ in settings),
            by_misfit.sum(axis=0),
        ]


POPULATIONS = {ChainDiscrepancy: PopulationDiscrepancy, ChainMisfit: PopulationMisfit}


def fused_comparison(op, inputs):
    """Output (..., sensor, *values) of a `ChainComparison` for inputs with any leading batch dimensions.

    Batches of parameters alone become one Op of the population; others are left to `Blockwise`.
    """
    expected = [*INPUTS.values(), 2]
    inputs = [without_unit_batch(x, ndim) for x, ndim in zip(inputs, expected, strict=True)]
    parameters, rest = inputs[:N_PARAMETERS], inputs[N_PARAMETERS:]
    if any(x.type.ndim != ndim for x, ndim in zip(rest, expected[N_PARAMETERS:], strict=True)):
        return Blockwise(op)(*inputs)
    depth = max(x.type.ndim - 1 for x in parameters)
    if depth == 0:
        return op(*inputs)
    if depth > 1:
        batched = [x for x in parameters if x.type.ndim > 1]
        batch = pt.broadcast_shape(*(tuple(x.shape)[:-1] for x in batched), arrays_are_shapes=True)
        parameters = [
            pt.broadcast_to(x, (*batch, x.shape[-1])).reshape((-1, x.shape[-1])) if x.type.ndim > 1 else x
            for x in parameters
        ]
    rows = [x[None] if x.type.ndim == 1 else x for x in parameters]
    result = POPULATIONS[type(op)](op.quantity)(*rows, *rest)
    if depth == 1:
        return result
    return result.reshape((*batch, *tuple(result.shape)[1:]), ndim=depth + result.ndim - 1)


def without_unit_batch(x, ndim):
    """Drop leading dimensions beyond `ndim` that have length one by their type, as `Blockwise` adds them."""
    extra = x.type.ndim - ndim
    if extra > 0 and all(x.type.broadcastable[:extra]):
        return x.dimshuffle(*range(extra, x.type.ndim))
    return x


@_vectorize_node.register(ChainComparison)
def vectorize_comparison(op, node, *batched_inputs):
    """Batches of parameters become the population Op."""
    return [fused_comparison(op, batched_inputs)]
