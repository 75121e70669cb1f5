"""Mean-square discrepancy as a PyTensor Op that never stores the response."""

import pytensor.tensor as pt
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply

from pymc_features.ops.base import StructuralOp, check_shape
from pymc_features.ops.gradient import DiscrepancyGradient
from pymc_features.ops.response import StructuralResponse


class StructuralComparison(StructuralOp):
    """Base: something of each sensor's misfit, from the parameters of a structure and the data.

    Attributes
    ----------
    values : tuple of int
        Shape of what there is for each sensor.
    """

    more_signature = "(s,u)"
    values: tuple[int, ...] = ()
    simulates = True  # a value that is not finite is a failed simulation, and counted as such

    def make_node(self, *inputs):
        *common, observed = inputs
        common = self.prepare_inputs(common)
        observed = pt.as_tensor_variable(observed).astype("float64")
        if observed.ndim != 2:
            raise ValueError(f"`observed` must be (sensor, time), got {observed.ndim} dimensions.")
        n_sensors = self.static_n_sensors(common)
        check_shape((n_sensors, self.static_n_outputs(common)), observed.type.shape)
        output = pt.tensor(dtype="float64", shape=(n_sensors, *self.values))
        return Apply(self, [*common, observed], [output])

    def infer_shape(self, node, shapes):
        return [(shapes[self.at("sensors")][0], *self.values)]


class StructuralDiscrepancy(StructuralComparison):
    """e_j of Eq. (3) straight from the parameters of a structure and the data."""

    kernel_name = "discrepancy"
    output_signature = "(s)"

    def pullback(self, inputs, outputs, cotangents):
        """By `DiscrepancyGradient`, and from the response for the data."""
        *common, observed = inputs
        [weights] = cotangents
        misfit = observed - self.like(StructuralResponse)(*common)
        return [
            *self.like(DiscrepancyGradient)(*inputs, weights, return_list=True),
            *(disconnected_type() for _ in common[self.n_parameters :]),
            weights[:, None] * (2.0 / observed.shape[1]) * misfit,
        ]
