"""The fused comparisons of a whole population, and how vectorised graphs come to use them."""

import pytensor.tensor as pt
from pytensor.gradient import disconnected_type, grad_undefined
from pytensor.graph.basic import Apply
from pytensor.graph.replace import _vectorize_node
from pytensor.tensor.blockwise import Blockwise

from pymc_features.ops.batches import in_one_call
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


@_vectorize_node.register(StructuralComparison)
def vectorize_comparison(op, node, *batched_inputs):
    """Batches of parameters become the population Op."""
    return [fused_comparison(op, batched_inputs)]
