"""Statistics of the misfit between response and data, as PyTensor Ops that never store the response.

The misfit is r = y - g. Its statistics are the mean of r(k)^2, which is e_j of Eq. (3), the sum of the
squared increments [r(k) - r(k - 1)]^2 over the number of samples, the first r and the last: the last three
are what errors correlated in time need besides.
"""

import pytensor.tensor as pt
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply

from pymc_features.ops.base import StructuralOp, check_shape
from pymc_features.ops.gradient import Gradient, ResponseTangent, Tangent
from pymc_features.ops.response import StructuralResponse


class StructuralComparison(StructuralOp):
    """Base: statistics of each sensor's misfit, from the parameters of a structure and the data.

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

    def pullback(self, inputs, outputs, cotangents):
        """By `MisfitGradient`, and from the response for the data."""
        *common, observed = inputs
        [weights] = cotangents
        if not self.values:
            weights = weights[:, None]
        gradient = self.like(MisfitGradient, n_statistics=4 if self.values else 1)
        misfit = observed - self.like(StructuralResponse)(*common)
        return [
            *gradient(*inputs, weights, return_list=True),
            *(disconnected_type() for _ in common[self.n_parameters :]),
            misfit_cotangent(misfit, weights),
        ]


class StructuralDiscrepancy(StructuralComparison):
    """e_j of Eq. (3) (sensor,)."""

    kernel_name = "discrepancy"
    output_signature = "(s)"


class StructuralMisfit(StructuralComparison):
    """All four statistics (sensor, 4)."""

    kernel_name = "misfit"
    output_signature = "(s,4)"
    values = (4,)


class MisfitGradient(Gradient):
    """Gradient of sum_jq c_jq times the first statistic, or all four.

    The last inputs are the data (sensor, time) and c (sensor, n_statistics).
    """

    __props__ = ("quantity", "family", "n_statistics")
    kernel_name = "misfit_gradient"

    def __init__(self, quantity="absolute_acceleration", family="chain", n_statistics=1):
        super().__init__(quantity, family)
        self.n_statistics = n_statistics

    @property
    def more_signature(self):
        """Shapes of the data and of c."""
        return f"(s,u),(s,{self.n_statistics})"

    def transpose(self, inputs, cotangents):
        """The change of the statistics along a direction; that of the last three from the response's."""
        if self.n_statistics == 1:
            return [self.like(DiscrepancyTangent)(*inputs, *cotangents)[:, None]]
        *common, observed = inputs
        misfit = observed - self.like(StructuralResponse)(*common)
        return [misfit_change(misfit, -self.like(ResponseTangent)(*common, *cotangents))]


class DiscrepancyTangent(Tangent):
    """Derivative (sensor,) of the discrepancy along a direction; the data come before that."""

    kernel_name = "discrepancy_tangent"
    more_signature = "(s,u),parameters"
    output_signature = "(s)"

    def output_variables(self, common):
        return [pt.tensor(dtype="float64", shape=(self.static_n_sensors(common),))]

    def infer_shape(self, node, shapes):
        return [(shapes[self.at("sensors")][0],)]

    def transpose(self, inputs, cotangents):
        [weights] = cotangents
        return self.like(MisfitGradient)(*inputs, weights[:, None], return_list=True)


def misfit_values(misfit):
    """Statistics (..., 4) of a misfit (..., time)."""
    n_times = pt.cast(misfit.shape[-1], "float64")
    steps = misfit[..., 1:] - misfit[..., :-1]
    squares = (pt.sum(pt.sqr(x), axis=-1) / n_times for x in (misfit, steps))
    return pt.stack([*squares, misfit[..., 0], misfit[..., -1]], axis=-1)


def misfit_cotangent(misfit, cotangent):
    """Derivative (..., time) of sum_q c_q times the statistics by the misfit; c (..., 1) or (..., 4)."""
    by_squares = (2.0 / misfit.shape[-1]) * cotangent[..., :1] * misfit
    if cotangent.type.shape[-1] == 1:
        return by_squares
    c = [cotangent[..., i, None] for i in range(4)]
    steps = misfit[..., 1:] - misfit[..., :-1]
    none = pt.zeros_like(misfit[..., :1])
    bends = pt.concatenate([none, steps], axis=-1) - pt.concatenate([steps, none], axis=-1)
    by_increments = by_squares + (2.0 / misfit.shape[-1]) * c[1] * bends
    by_first = pt.inc_subtensor(by_increments[..., :1], c[2])
    return pt.inc_subtensor(by_first[..., -1:], c[3])


def misfit_change(misfit, change):
    """Change (..., 4) of the statistics for a change (..., time) of the misfit, its cotangent transposed."""
    n_times = pt.cast(misfit.shape[-1], "float64")
    pairs = ((misfit, change), (pt.diff(misfit, axis=-1), pt.diff(change, axis=-1)))
    squares = (2.0 * pt.sum(x * d, axis=-1) / n_times for x, d in pairs)
    return pt.stack([*squares, change[..., 0], change[..., -1]], axis=-1)
