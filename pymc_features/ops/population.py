"""The fused comparisons of a whole population, and how vectorised graphs come to use them."""

import pytensor.tensor as pt
from pytensor.gradient import disconnected_type, grad_undefined
from pytensor.graph.basic import Apply
from pytensor.graph.replace import _vectorize_node
from pytensor.tensor.blockwise import Blockwise

from pymc_features.ops.base import StructuralOp, count
from pymc_features.ops.discrepancy import StructuralComparison, StructuralDiscrepancy
from pymc_features.ops.gradient import PopulationGradient, ResponseGradient
from pymc_features.ops.misfit import StructuralMisfit, misfit_cotangent
from pymc_features.ops.response import StructuralResponse


class PopulationComparison(StructuralOp):
    """Base: as `StructuralComparison`, where each parameter has a row for each particle.

    A parameter that all particles share has a single row. The result is (particle, sensor, *values).
    """

    gufunc_signature = None
    values: tuple[int, ...] = ()
    simulates = True

    def make_node(self, *inputs):
        *common, observed = inputs
        parameters = [pt.as_tensor_variable(x).astype("float64") for x in common[: self.n_parameters]]
        for (name, dims), parameter in zip(self.spec.parameters.items(), parameters, strict=True):
            if parameter.ndim != 1 + count(dims):
                raise ValueError(f"`{name}` must be (particle, {dims}), got {parameter.ndim} dimensions.")
        common = [*parameters, *self.prepare_inputs(common[self.n_parameters :], start=self.n_parameters)]
        observed = pt.as_tensor_variable(observed).astype("float64")
        if observed.ndim != 2:
            raise ValueError(f"`observed` must be (sensor, time), got {observed.ndim} dimensions.")
        output = pt.tensor(dtype="float64", shape=(None, self.static_n_sensors(common), *self.values))
        return Apply(self, [*common, observed], [output])

    def infer_shape(self, node, shapes):
        rows = shapes[0][0]
        for shape in shapes[1 : self.n_parameters]:
            rows = pt.maximum(rows, shape[0])
        return [(rows, shapes[self.at("sensors")][0], *self.values)]


class PopulationDiscrepancy(PopulationComparison):
    """e_j of Eq. (3) for a population (particle, sensor); no history of any particle is stored."""

    kernel_name = "population_discrepancy"

    def pullback(self, inputs, outputs, cotangents):
        """By `PopulationGradient`; the data of a population are not differentiated."""
        return [
            *self.like(PopulationGradient)(*inputs, *cotangents, return_list=True),
            *(disconnected_type() for _ in inputs[self.n_parameters : -1]),
            grad_undefined(self, len(inputs) - 1, inputs[-1], "Differentiate one particle, or the response."),
        ]


class PopulationMisfit(PopulationComparison):
    """Statistics of the misfit (particle, sensor, 4), as `StructuralMisfit`; no history is stored."""

    kernel_name = "population_misfit"
    values = (4,)

    def pullback(self, inputs, outputs, cotangents):
        """From the responses of all particles, which are stored for this: (particle, sensor, time)."""
        n = self.n_parameters
        parameters, settings, observed = inputs[:n], inputs[n:-1], inputs[-1]
        n_particles = outputs[0].shape[0]
        rows = [pt.broadcast_to(x, (n_particles, *tuple(x.shape)[1:])) for x in parameters]
        responses = Blockwise(self.like(StructuralResponse))(*rows, *settings)
        by_misfit = misfit_cotangent(observed - responses, *cotangents)
        gradients = Blockwise(self.like(ResponseGradient))(*rows, *settings, -by_misfit, return_list=True)
        return [
            # what all particles share gets the sum
            *(
                g.reshape((n_particles // x.shape[0], *x.shape)).sum(axis=0)
                for g, x in zip(gradients, parameters, strict=True)
            ),
            *(disconnected_type() for _ in settings),
            by_misfit.sum(axis=0),
        ]


POPULATIONS = {StructuralDiscrepancy: PopulationDiscrepancy, StructuralMisfit: PopulationMisfit}


def fused_comparison(op, inputs):
    """Output (..., sensor, *values) of a `StructuralComparison` for inputs with any leading batch dimensions.

    Batches of parameters alone become one Op of the population; others are left to `Blockwise`.
    """
    n = op.n_parameters
    expected = [*(count(dims) for dims in op.spec.inputs.values()), 2]
    inputs = [without_unit_batch(x, ndim) for x, ndim in zip(inputs, expected, strict=True)]
    if any(x.type.ndim != ndim for x, ndim in zip(inputs[n:], expected[n:], strict=True)):
        return Blockwise(op)(*inputs)
    depths = [x.type.ndim - ndim for x, ndim in zip(inputs[:n], expected[:n], strict=True)]
    depth = max(depths)
    if depth == 0:
        return op(*inputs)
    parameters, batch = inputs[:n], ()
    if depth > 1:
        leading = [tuple(x.shape)[:own] for x, own in zip(parameters, depths, strict=True) if own]
        batch = pt.broadcast_shape(*leading, arrays_are_shapes=True)
        parameters = [
            flat_batch(x, batch, own) if own else x for x, own in zip(parameters, depths, strict=True)
        ]
    rows = [x if own else x[None] for x, own in zip(parameters, depths, strict=True)]
    result = op.like(POPULATIONS[type(op)])(*rows, *inputs[n:])
    if depth == 1:
        return result
    return result.reshape((*batch, *tuple(result.shape)[1:]), ndim=depth + result.ndim - 1)


def flat_batch(x, batch, depth):
    """Spread the first `depth` dimensions over `batch` and make one of them."""
    core = tuple(x.shape)[depth:]
    return pt.broadcast_to(x, (*batch, *core)).reshape((-1, *core), ndim=1 + len(core))


def without_unit_batch(x, ndim):
    """Drop leading dimensions beyond `ndim` that have length one by their type, as `Blockwise` adds them."""
    extra = x.type.ndim - ndim
    if extra > 0 and all(x.type.broadcastable[:extra]):
        return x.dimshuffle(*range(extra, x.type.ndim))
    return x


@_vectorize_node.register(StructuralComparison)
def vectorize_comparison(op, node, *batched_inputs):
    """Batches of parameters become the population Op."""
    return [fused_comparison(op, batched_inputs)]
