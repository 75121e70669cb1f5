"""The fused comparisons of a whole population, and how vectorised graphs come to use them."""

import pytensor.tensor as pt
from pytensor.gradient import disconnected_type, grad_undefined
from pytensor.graph.basic import Apply
from pytensor.graph.replace import _vectorize_node
from pytensor.tensor.blockwise import Blockwise

from pymc_features.ops.comparison import (
    DiscrepancyTangent,
    MisfitGradient,
    StructuralComparison,
    StructuralDiscrepancy,
    StructuralMisfit,
)
from pymc_features.ops.gradient import gradient_op
from pymc_features.ops.long_records import FromTable
from pymc_features.ops.structural import StructuralOp, count


class PopulationComparison(StructuralOp):
    """Base: as `StructuralComparison`, where each parameter has a row for each particle.

    A parameter that all particles share has a single row. The result is (particle, sensor, *values); no
    history of any particle is stored, for the gradient neither.
    """

    more_signature = "(s,u)"
    batched = True
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
        return [(*self.population(shapes), shapes[self.at("sensors")][0], *self.values)]

    def pullback(self, inputs, outputs, cotangents):
        """By `PopulationGradient`; the data of a population are not differentiated."""
        [weights] = cotangents
        gradient = gradient_op(self, PopulationGradient, inputs, n_statistics=4 if self.values else 1)
        return [
            *gradient(*inputs, weights if self.values else weights[..., None], return_list=True),
            *(disconnected_type() for _ in inputs[self.n_parameters : -1]),
            grad_undefined(self, len(inputs) - 1, inputs[-1], "Differentiate one particle, or the response."),
        ]


class PopulationDiscrepancy(FromTable, PopulationComparison):
    """e_j of Eq. (3) for a population (particle, sensor)."""

    kernel_name = "population_discrepancy"


class PopulationMisfit(PopulationComparison):
    """All four statistics of the misfit (particle, sensor, 4)."""

    kernel_name = "population_misfit"
    values = (4,)


class PopulationGradient(MisfitGradient):
    """Gradient as of `MisfitGradient`, of a population; c (particle, sensor, n_statistics)."""

    kernel_name = "population_gradient"
    batched = True

    @property
    def more_signature(self):
        """Shapes of the data and of c."""
        return f"(s,u),(particle,s,{self.n_statistics})"

    def transpose(self, inputs, cotangents):
        """Particle by particle; of increments the changes of all responses would have to be stored."""
        n = self.n_parameters
        if self.n_statistics > 1:
            raise NotImplementedError(
                "The gradient of the misfit's increments has no forward mode for a population. "
                "Differentiate one particle at a time."
            )
        rows = pt.as_tensor_variable(1)
        for x in inputs[:n]:
            rows = pt.maximum(rows, x.shape[0])
        spread = [pt.broadcast_to(x, (rows, *tuple(x.shape)[1:])) for x in (*inputs[:n], *cotangents)]
        tangent = Blockwise(self.like(DiscrepancyTangent))
        return [tangent(*spread[:n], *inputs[n:], *spread[n:])[..., None]]


POPULATIONS = {StructuralDiscrepancy: PopulationDiscrepancy, StructuralMisfit: PopulationMisfit}


def fused_comparison(op, inputs):
    """Output (..., sensor, *values) of a `StructuralComparison` for inputs with any leading dimensions."""
    ndims = [*(count(dims) for dims in op.inputs.values()), 2]
    [result] = in_one_call(op, op.like(POPULATIONS[type(op)]), inputs, ndims)
    return result


def in_one_call(op, population, inputs, ndims) -> list:
    """Outputs of an Op for inputs with any leading batch dimensions.

    Batches of parameters alone become one call of the Op of the population; others are left to `Blockwise`.
    """
    n = op.n_parameters
    inputs = [without_unit_batch(x, ndim) for x, ndim in zip(inputs, ndims, strict=True)]
    alone = [x.type.ndim == ndim for x, ndim in zip(inputs, ndims, strict=True)]
    if op.batched or not all(alone[n:]):
        return Blockwise(op)(*inputs, return_list=True)
    if all(alone):
        return op(*inputs, return_list=True)
    rows, batch = as_rows(inputs[:n], ndims[:n])
    results = population(*rows, *inputs[n:], return_list=True)
    if batch is None:
        return results
    return [x.reshape((*batch, *tuple(x.shape)[1:]), ndim=len(batch) + x.ndim - 1) for x in results]


def as_rows(parameters, ndims):
    """Parameters with any leading batch dimensions as rows of a population, one row for what has none.

    Returns also the shape of the batch, None if it has one dimension: the rows are its entries then.
    """
    depths = [x.type.ndim - ndim for x, ndim in zip(parameters, ndims, strict=True)]
    batch = None
    if max(depths) > 1:
        leading = [tuple(x.shape)[:own] for x, own in zip(parameters, depths, strict=True) if own]
        batch = tuple(pt.broadcast_shape(*leading, arrays_are_shapes=True))
        parameters = [
            flat_batch(x, batch, own) if own else x for x, own in zip(parameters, depths, strict=True)
        ]
    return [x if own else x[None] for x, own in zip(parameters, depths, strict=True)], batch


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


def take_batches(*op_classes, first: int | None = None):
    """Let the first inputs of Ops, by default all, have any leading dimensions; the others are without."""

    def vectorize(op, node, *inputs):
        n = len(inputs) if first is None else first
        shared = [without_unit_batch(x, y.ndim) for x, y in zip(inputs[n:], node.inputs[n:], strict=True)]
        if any(x.ndim != y.ndim for x, y in zip(shared, node.inputs[n:], strict=True)):
            raise NotImplementedError(f"all inputs of {op} but the first {n} are the same for all particles")
        return op(*inputs[:n], *shared, return_list=True)

    for op_class in op_classes:
        _vectorize_node.register(op_class)(vectorize)


@_vectorize_node.register(StructuralComparison)
def vectorize_comparison(op, node, *batched_inputs):
    """Batches of parameters become the population Op."""
    return [fused_comparison(op, batched_inputs)]
