"""Mean-square discrepancy as a PyTensor Op that never stores the response, and its public function."""

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Apply, Variable
from pytensor.tensor.blockwise import Blockwise

from pymc_features.ops.base import INPUT_SIGNATURE, INPUTS, ChainOp
from pymc_features.ops.response import response_node
from pymc_features.simulators import chain_discrepancy


class ChainDiscrepancy(ChainOp):
    """e_j of Eq. (3) straight from the parameters of a spring-mass chain and the data."""

    gufunc_signature = f"{INPUT_SIGNATURE},(s,u)->(s)"

    def make_node(self, *inputs):
        *common, observed = inputs
        common = self.prepare_inputs(common)
        observed = pt.as_tensor_variable(observed).astype("float64")
        if observed.ndim != 2:
            raise ValueError(f"`observed` must be (sensor, time), got {observed.ndim} dimensions.")
        check_shape((common[8].type.shape[0], self.static_n_outputs(common)), observed.type.shape)
        output = pt.tensor(dtype="float64", shape=(common[8].type.shape[0],))
        return Apply(self, [*common, observed], [output])

    def infer_shape(self, node, shapes):
        return [(shapes[8][0],)]

    def perform(self, node, inputs, output_storage):
        *common, observed = [np.ascontiguousarray(x) if np.ndim(x) else x.item() for x in inputs]
        output_storage[0][0] = chain_discrepancy(*common, self.quantity_code, observed)


def check_shape(expected, got, name="observed"):
    """Refuse static shapes (None where unknown) of (..., sensor, time) arrays that cannot agree."""
    pairs = list(zip(expected[::-1], got[::-1], strict=False))[:2]
    if all(a is None or b is None or a == b for a, b in pairs):
        return
    known = tuple(expected[-2:])
    hint = "Give one row for each sensor and one column for each output step."
    if tuple(got[-2:]) == known[::-1]:
        hint = "Transpose it: time is the last axis."
    raise ValueError(
        f"`{name}` must have shape (sensor, time) = {known} to match `mu`, got {tuple(got)}. {hint}"
    )


def mean_square_discrepancy(mu, observed):
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
    mu, observed = pt.as_tensor_variable(mu), pt.as_tensor_variable(observed)
    check_shape(mu.type.shape, observed.type.shape)
    node = response_node(mu)
    if node is None or observed.ndim < 2:
        return pt.mean(pt.sqr(observed - mu), axis=-1)
    core = node.op.core_op if isinstance(node.op, Blockwise) else node.op
    fused = ChainDiscrepancy(core.quantity)
    batched = isinstance(node.op, Blockwise) or observed.ndim > 2
    inputs = node.inputs[: len(INPUTS)]
    return (Blockwise(fused) if batched else fused)(*inputs, observed)
