"""Comparison of response and data, computed the cheapest way the arguments allow."""

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Variable
from pytensor.tensor import TensorLike, TensorVariable
from pytensor.tensor.blockwise import Blockwise

from pymc_features.ops.base import check_shape
from pymc_features.ops.comparison import StructuralDiscrepancy, StructuralMisfit, misfit_values
from pymc_features.ops.external import ExternalResponse
from pymc_features.ops.population import fused_comparison
from pymc_features.ops.response import response_node


def mean_square_discrepancy(mu: TensorLike, observed: TensorLike) -> np.ndarray | TensorVariable:
    """Mean-square discrepancy of each sensor, e_j = mean_k [y_j(k) - g_j(k)]^2, Eq. (3).

    Parameters
    ----------
    mu : array_like or TensorVariable (..., sensor, time)
        Model response, in the units of the data.
    observed : array_like or TensorVariable (..., sensor, time)
        Measured response.

    Returns
    -------
    array or TensorVariable (..., sensor)
        e_j in the square of those units. NumPy in, NumPy out.

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
    """
    if not isinstance(mu, Variable) and not isinstance(observed, Variable):
        mu, observed = np.asarray(mu, dtype=np.float64), np.asarray(observed, dtype=np.float64)
        check_shape(mu.shape, observed.shape)
        return np.mean((observed - mu) ** 2, axis=-1)
    return fused_or_plain(
        StructuralDiscrepancy, lambda misfit: pt.mean(pt.sqr(misfit), axis=-1), mu, observed
    )


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
    mu, observed = pt.as_tensor_variable(mu), pt.as_tensor_variable(observed)
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
    return fused_comparison(core.like(op_type), [*node.inputs[: core.n_common], observed])
