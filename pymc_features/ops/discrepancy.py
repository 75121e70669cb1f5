"""Mean-square discrepancy as a PyTensor Op that never stores the response."""

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply

from pymc_features.ops.base import INPUT_SIGNATURE, N_PARAMETERS, ChainOp
from pymc_features.ops.gradient import ChainDiscrepancyGradient
from pymc_features.ops.response import ChainResponse
from pymc_features.simulators import chain_discrepancy


class ChainComparison(ChainOp):
    """Base: something of each sensor's misfit, from the parameters of a spring-mass chain and the data.

    Attributes
    ----------
    kernel : callable
        Arrays in, an array (s, *values) out.
    values : tuple of int
        Shape of what there is for each sensor.
    """

    kernel = None
    values: tuple[int, ...] = ()
    simulates = True  # a value that is not finite is a failed simulation, and counted as such

    def make_node(self, *inputs):
        *common, observed = inputs
        common = self.prepare_inputs(common)
        observed = pt.as_tensor_variable(observed).astype("float64")
        if observed.ndim != 2:
            raise ValueError(f"`observed` must be (sensor, time), got {observed.ndim} dimensions.")
        check_shape((common[8].type.shape[0], self.static_n_outputs(common)), observed.type.shape)
        output = pt.tensor(dtype="float64", shape=(common[8].type.shape[0], *self.values))
        return Apply(self, [*common, observed], [output])

    def infer_shape(self, node, shapes):
        return [(shapes[8][0], *self.values)]

    def perform(self, node, inputs, output_storage):
        *common, observed = [np.ascontiguousarray(x) if np.ndim(x) else x.item() for x in inputs]
        output_storage[0][0] = type(self).kernel(*common, self.quantity_code, observed)


class ChainDiscrepancy(ChainComparison):
    """e_j of Eq. (3) straight from the parameters of a spring-mass chain and the data."""

    gufunc_signature = f"{INPUT_SIGNATURE},(s,u)->(s)"
    kernel = staticmethod(chain_discrepancy)

    def pullback(self, inputs, outputs, cotangents):
        """By `ChainDiscrepancyGradient`, and from the response for the data."""
        *common, observed = inputs
        [weights] = cotangents
        misfit = observed - ChainResponse(self.quantity)(*common)
        return [
            *ChainDiscrepancyGradient(self.quantity)(*inputs, weights),
            *(disconnected_type() for _ in common[N_PARAMETERS:]),
            weights[:, None] * (2.0 / observed.shape[1]) * misfit,
        ]


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
