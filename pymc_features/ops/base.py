"""What the response Ops share: their inputs, and what a gradient depends on."""

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Constant, Variable
from pytensor.graph.op import Op

from pymc_features.simulators import QUANTITIES, n_outputs

# name and number of dimensions of the inputs common to all Ops, in the order of the kernels
INPUTS = {
    "mass": 1,
    "stiffness": 1,
    "rayleigh": 1,
    "ratios": 1,
    "acceleration": 1,
    "dt": 0,
    "substeps": 0,
    "stride": 0,
    "sensors": 1,
    "n_modes": 0,
}
N_PARAMETERS = 4  # the first four describe the structure and may be random
INTEGERS = ("substeps", "stride", "sensors", "n_modes")
INPUT_SIGNATURE = "(n),(n),(2),(n),(t),(),(),(),(s),()"


class ChainOp(Op):
    """Base of the Ops on a spring-mass chain.

    Parameters
    ----------
    quantity : str
        One of `simulators.QUANTITIES`; the only property, since it changes the code. Everything else
        the kernels read is an input of the node, so that equal Ops always do the same.
    """

    __props__ = ("quantity",)

    def __init__(self, quantity: str = "absolute_acceleration"):
        self.quantity = quantity
        self.quantity_code = QUANTITIES.index(quantity)

    @staticmethod
    def prepare_inputs(inputs, start=0):
        """Cast the common inputs from number `start` on, and check their numbers of dimensions."""
        prepared = []
        for (name, ndim), value in zip(list(INPUTS.items())[start:], inputs, strict=True):
            dtype = "int64" if name in INTEGERS else "float64"
            if not isinstance(value, Variable):
                value = np.asarray(value, dtype=dtype)
            tensor = pt.as_tensor_variable(value)
            if tensor.ndim != ndim:
                raise ValueError(
                    f"`{name}` must have {ndim} dimensions, got {tensor.ndim}. "
                    "Use `pytensor.graph.vectorize_graph` for batches."
                )
            prepared.append(tensor if tensor.dtype == dtype else tensor.astype(dtype))
        return prepared

    @staticmethod
    def static_n_outputs(inputs) -> int | None:
        """Number of output samples where record and step are known when the graph is built."""
        n_times = inputs[4].type.shape[0]
        substeps, stride = inputs[6], inputs[7]
        if n_times is None or not (isinstance(substeps, Constant) and isinstance(stride, Constant)):
            return None
        return int(n_outputs(n_times, int(substeps.data), int(stride.data)))

    @staticmethod
    def symbolic_n_outputs(node, shapes):
        """Number of output samples as a tensor."""
        substeps, stride = node.inputs[6], node.inputs[7]
        return ((shapes[4][0] - 1) * substeps) // stride + 1

    def connection_pattern(self, node):
        """Parameters and data count; the record, the sampling and the sensors do not."""
        counts = [i < N_PARAMETERS or i >= len(INPUTS) for i in range(len(node.inputs))]
        return [[c] * len(node.outputs) for c in counts]
