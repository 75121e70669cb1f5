"""Comparison of response and data: statistics of their misfit, by Ops that never store the response.

The misfit is r = y - g. Its statistics are the mean of r(k)^2, which is e_j of Eq. (3), the sum of the
squared increments [r(k) - r(k - 1)]^2 over the number of samples, the first r and the last: the last three
are what errors correlated in time need besides.

NaN in the data is a gap. The Ops add up the squares of the other samples and divide by the number of all; the
graph multiplies by the number of all over that of the samples measured, which is the data's alone.
"""

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply, Constant, Variable
from pytensor.graph.replace import _vectorize_node
from pytensor.tensor import TensorLike, TensorVariable
from pytensor.tensor.blockwise import Blockwise

from pymc_features._checks import as_numbers
from pymc_features.ops.external import ExternalResponse
from pymc_features.ops.gradient import Gradient, ResponseTangent, Tangent, gradient_op
from pymc_features.ops.long_records import FromTable
from pymc_features.ops.response import StructuralResponse, response_node
from pymc_features.ops.structural import StructuralOp, check_shape
from pymc_features.structures.base import as_tensor

HISTORY = "Pass a history (..., sensor, time)."


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
        gradient = gradient_op(self, MisfitGradient, inputs, n_statistics=4 if self.values else 1)
        misfit = observed - self.like(StructuralResponse)(*common)
        if not self.values:
            misfit = pt.switch(pt.isnan(observed), 0.0, misfit)
        return [
            *gradient(*inputs, weights, return_list=True),
            *(disconnected_type() for _ in common[self.n_parameters :]),
            misfit_cotangent(misfit, weights),
        ]


class StructuralDiscrepancy(FromTable, StructuralComparison):
    """e_j of Eq. (3) (sensor,), of data without gaps; with them the sum has fewer terms."""

    kernel_name = "discrepancy"
    output_signature = "(s)"


class StructuralMisfit(StructuralComparison):
    """All four statistics (sensor, 4)."""

    kernel_name = "misfit"
    output_signature = "(s,4)"
    values = (4,)


class MisfitGradient(FromTable, Gradient):
    """Gradient of sum_jq c_jq times the first statistic, or all four.

    The last inputs are the data (sensor, time) and c (sensor, n_statistics).
    """

    __props__ = ("quantity", "family", "n_statistics", "sought")
    kernel_name = "misfit_gradient"

    def __init__(self, quantity="absolute_acceleration", family="chain", n_statistics=1, sought=None):
        super().__init__(quantity, family, sought)
        self.n_statistics = n_statistics

    @property
    def kernel(self):
        """That of e_j alone, if there is one, where nothing else is weighted."""
        return self.spec.of_squares(self.kernel_name) if self.n_statistics == 1 else super().kernel

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
        return gradient_op(self, MisfitGradient, inputs)(*inputs, weights[:, None], return_list=True)


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


def measured_samples(observed):
    """Numbers (..., sensor) of samples that are no gaps, float64; None of data known to have no gaps."""
    if isinstance(observed, Constant) and not np.isnan(observed.data).any():
        return None
    return pt.sum(pt.invert(pt.isnan(observed)), axis=-1).astype("float64")


def mean_square_discrepancy(mu: TensorLike, observed: TensorLike) -> np.ndarray | TensorVariable:
    """Mean-square discrepancy of each sensor, e_j = mean_k [y_j(k) - g_j(k)]^2, Eq. (3).

    The mean is over the samples that were measured: NaN in the data is a gap.

    Parameters
    ----------
    mu : array_like or TensorVariable (..., sensor, time)
        Model response, in the units of the data.
    observed : array_like or TensorVariable (..., sensor, time)
        Measured response, NaN where there is none.

    Returns
    -------
    array or TensorVariable (..., sensor)
        e_j in the square of those units; NaN of a sensor without any data. NumPy in, NumPy out.

    Raises
    ------
    ValueError
        If the last two axes do not have equal lengths.

    Notes
    -----
    Where `mu` comes from `response`, the tensor returned is computed from the parameters directly
    and no history is stored.

    Examples
    --------
    >>> mean_square_discrepancy([[1.0, 2.0], [0.0, 0.0]], [[1.0, 4.0], [3.0, 3.0]])
    array([2., 9.])
    >>> mean_square_discrepancy([[1.0, 2.0]], [[np.nan, 4.0]])
    array([4.])
    """
    if not isinstance(mu, Variable) and not isinstance(observed, Variable):
        mu, observed = as_numbers(mu, "mu", HISTORY), as_numbers(observed, "observed", HISTORY)
        check_histories(mu, observed)
        check_shape(mu.shape, observed.shape)
        return mean_of_measured(mu, observed)
    mu, observed = as_tensor(mu, "mu", HISTORY), as_tensor(observed, "observed", HISTORY)
    n_measured = measured_samples(observed)

    def plain(misfit):
        misfit = misfit if n_measured is None else pt.switch(pt.isnan(observed), 0.0, misfit)
        return pt.mean(pt.sqr(misfit), axis=-1)

    e = fused_or_plain(StructuralDiscrepancy, plain, mu, observed)
    if n_measured is None or comes_as_mean_square(mu):
        return e
    return e * (pt.cast(observed.shape[-1], "float64") / n_measured)


def mean_of_measured(mu, observed):
    """Mean squares of observed - mu over the samples that are no gaps, of arrays."""
    gaps = np.isnan(observed)
    if not gaps.any():
        return np.mean((observed - mu) ** 2, axis=-1)
    squares = np.where(gaps, 0.0, observed - mu) ** 2
    with np.errstate(invalid="ignore"):
        return np.sum(squares, axis=-1) / np.sum(~gaps, axis=-1)


def comes_as_mean_square(mu) -> bool:
    """Whether a simulator outside computes e_j itself, and with it knows of the gaps."""
    node = response_node(mu)
    core = getattr(node.op, "core_op", node.op) if node is not None else None
    return isinstance(core, ExternalResponse) and core.simulator.returns == "mean_square"


def check_histories(mu, observed) -> None:
    """Refuse what has no samples: numbers, and empty arrays."""
    for name, shape in (("mu", mu.shape), ("observed", observed.shape)):
        if not shape or 0 in shape:
            raise ValueError(f"`{name}` must be a history (..., sensor, time), got shape {shape}. {HISTORY}")


def misfit_statistics(mu, observed):
    """What errors correlated in time need of the misfit r = y - g of each sensor.

    Parameters
    ----------
    mu, observed : tensor_like (..., sensor, time)
        Model response, and measured response in the same units.

    Returns
    -------
    TensorVariable (..., sensor, 4)
        Mean square of r, sum of its squared increments [r(k) - r(k - 1)]^2 over the number of samples, its
        first value and its last.

    Raises
    ------
    ValueError
        If the last two axes do not have equal lengths.

    Notes
    -----
    Where `mu` comes from `response`, no history is stored, for the gradient neither.

    Examples
    --------
    >>> misfit_statistics([[0.0, 0.0]], [[1.0, 3.0]]).eval()
    array([[5., 2., 1., 3.]])
    """
    return fused_or_plain(StructuralMisfit, misfit_values, mu, observed)


def fused_or_plain(op_type, plain, mu, observed):
    """The Op where `mu` comes from `response`, else `plain(observed - mu)`."""
    mu, observed = as_tensor(mu, "mu", HISTORY), as_tensor(observed, "observed", HISTORY)
    check_histories(mu.type, observed.type)
    check_shape(mu.type.shape, observed.type.shape)
    node = response_node(mu)
    if node is None or observed.ndim < 2:
        return plain(observed - mu)
    core = node.op.core_op if isinstance(node.op, Blockwise) else node.op
    if isinstance(core, ExternalResponse):
        simple = op_type is StructuralDiscrepancy and core is node.op and observed.ndim == 2
        if not simple and core.simulator.returns == "mean_square":
            raise ValueError(
                "`mu` must be a history here, got a simulator that returns mean squares. Use NORM, "
                "TruncNormalFeature or ExpFeature, or let the simulator return responses."
            )
        return core.compare(node.inputs, observed) if simple else plain(observed - mu)
    # one particle, or the Op of the population, see `population.fused_comparison`
    return _vectorize_node(core.like(op_type), None, *node.inputs[: core.n_common], observed)[0]
