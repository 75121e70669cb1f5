"""Natural frequencies, mode shapes and damping ratios as PyTensor Ops, and their gradients."""

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply, Constant, Variable
from pytensor.graph.op import Op
from pytensor.graph.replace import _vectorize_node
from pytensor.tensor.blockwise import Blockwise

from pymc_features.ops.base import count, shapes
from pymc_features.ops.gradient import filled, undefined
from pymc_features.ops.population import as_rows, without_unit_batch
from pymc_features.simulators import FAMILIES, Outputs
from pymc_features.simulators.modal.perturbation import Cotangent
from pymc_features.simulators.reduced.known import KNOWN

OUTPUTS = ("(m)", "(m,s)", "(m)")


class ModalOp(Op):
    """Base of the Ops on modes: parameters of a family, its constants, sensors and number of modes.

    Parameters
    ----------
    family : str
        A key of `simulators.FAMILIES`. Everything else the kernels read is an input of the node.
    batched : bool
        Whether each parameter has a row for each particle, or one for all.
    """

    __props__ = ("family", "batched")
    kernel_name: str

    def __init__(self, family: str, batched: bool = False):
        self.family, self.batched = family, batched

    @property
    def spec(self):
        """The family: no attribute, for machine code does not travel with pickled Ops."""
        return FAMILIES[self.family]

    @property
    def n_parameters(self) -> int:
        """Number of parameters, the first inputs."""
        return len(self.spec.parameters)

    @property
    def ndims(self) -> tuple[int, ...]:
        """Numbers of dimensions of the inputs of one structure."""
        inputs = *self.spec.parameters.values(), *self.spec.constants.values()
        return *(count(dims) for dims in inputs), 1, 0

    @property
    def gufunc_signature(self):
        """Shapes for one particle; a population Op is never wrapped."""
        if self.batched:
            return None
        common = shapes(self.spec.parameters | self.spec.constants | {"sensors": "s", "n_modes": ""})
        return f"{common}{self.more_signature}->{self.output_signature}"

    def prepare_inputs(self, inputs):
        """Cast inputs common to all Ops, and check their numbers of dimensions."""
        types = [self.spec.dtype(name) for name in (*self.spec.parameters, *self.spec.constants)]
        prepared = []
        for i, (x, ndim, dtype) in enumerate(
            zip(inputs, self.ndims, [*types, "int64", "int64"], strict=True)
        ):
            tensor = x if isinstance(x, Variable) else pt.as_tensor_variable(np.asarray(x, dtype=dtype))
            expected = ndim + (self.batched and i < self.n_parameters)
            if tensor.ndim != expected:
                raise ValueError(f"input {i} must have {expected} dimensions, got {tensor.ndim}.")
            prepared.append(tensor if tensor.dtype == dtype else tensor.astype(dtype))
        return prepared

    def prepare_node(self, node, storage_map, compute_map, impl):
        """Forget what other functions have learnt, so that a run with the same seed is the same."""
        KNOWN.forget()

    def perform(self, node, inputs, output_storage):
        for storage, result in zip(output_storage, self.run(inputs), strict=True):
            storage[0] = result

    def run(self, inputs) -> tuple[np.ndarray, ...]:
        """What the kernel makes of arrays; it takes a population, of which one structure is the first."""
        n, n_common = self.n_parameters, len(self.ndims)
        arrays = [np.require(x, requirements=["C", "W"]) if np.ndim(x) else x.item() for x in inputs]
        if not self.batched:
            rows = [i < n or i >= n_common for i in range(len(arrays))]
            arrays = [x[None] if row else x for x, row in zip(arrays, rows, strict=True)]
        parameters = self.spec.arguments(*arrays[: n_common - 2])
        wanted = Outputs(arrays[n_common - 2], arrays[n_common - 1], 0)
        results = self.spec.modal[self.kernel_name](parameters, wanted, *self.more(arrays[n_common:]))
        return tuple(results) if self.batched else tuple(result[0] for result in results)

    def connection_pattern(self, node):
        """Parameters and cotangents count; constants, sensors and the number of modes do not."""
        last = len(self.ndims)
        counts = [i < self.n_parameters or i >= last for i in range(len(node.inputs))]
        return [[c] * len(node.outputs) for c in counts]


class StructuralModes(ModalOp):
    """Natural frequencies (mode,) [Hz], shapes (mode, sensor) and damping ratios (mode,)."""

    kernel_name = "modes"
    more_signature, output_signature = "", ",".join(OUTPUTS)
    simulates = True  # a value that is not finite is a failed simulation, and counted as such

    def more(self, arrays):
        """Nothing else."""
        return ()

    def make_node(self, *inputs):
        inputs = self.prepare_inputs(inputs)
        *_, sensors, n_modes = inputs
        m = int(n_modes.data) if isinstance(n_modes, Constant) else None
        rows = (None,) if self.batched else ()
        kinds = (m,), (m, sensors.type.shape[0]), (m,)
        return Apply(self, inputs, [pt.tensor(dtype="float64", shape=(*rows, *shape)) for shape in kinds])

    def infer_shape(self, node, shapes):
        rows = ()
        if self.batched:
            most = shapes[0][0]
            for shape in shapes[1 : self.n_parameters]:
                most = pt.maximum(most, shape[0])
            rows = (most,)
        m, s = node.inputs[-1], shapes[-2][0]
        return [(*rows, m), (*rows, m, s), (*rows, m)]

    def pullback(self, inputs, outputs, cotangents):
        """By `ModesGradient`."""
        gradient = ModesGradient(self.family, self.batched)
        gradients = gradient(*inputs, *filled(cotangents, outputs), return_list=True)
        return [*gradients, *(disconnected_type() for _ in inputs[self.n_parameters :])]


class ModesGradient(ModalOp):
    """Gradient of sum c f + sum W phi + sum d zeta; the last inputs are c (m,), W (m, s) and d (m,)."""

    kernel_name = "modes_gradient"
    more_signature = "," + ",".join(OUTPUTS)

    @property
    def output_signature(self):
        """Shapes of the outputs are those of the parameters."""
        return shapes(self.spec.parameters)

    def more(self, arrays):
        """The cotangents, in one tuple."""
        return (Cotangent(*arrays),)

    def make_node(self, *inputs):
        common, more = inputs[: len(self.ndims)], inputs[len(self.ndims) :]
        common = self.prepare_inputs(common)
        more = [pt.as_tensor_variable(x).astype("float64") for x in more]
        return Apply(self, [*common, *more], [x.type() for x in common[: self.n_parameters]])

    def infer_shape(self, node, shapes):
        return shapes[: self.n_parameters]

    def pullback(self, inputs, outputs, cotangents):
        """No second derivatives."""
        pattern = self.connection_pattern(outputs[0].owner)
        return [
            undefined(self, inputs, i) if counts else disconnected_type()
            for i, (counts, *_) in enumerate(pattern)
        ]


@_vectorize_node.register(StructuralModes)
def vectorize_modes(op, node, *inputs):
    """Batches of parameters alone become one Op of the population; others are left to `Blockwise`."""
    n = op.n_parameters
    inputs = [without_unit_batch(x, ndim) for x, ndim in zip(inputs, op.ndims, strict=True)]
    constants = inputs[n:]
    if op.batched or any(x.ndim != ndim for x, ndim in zip(constants, op.ndims[n:], strict=True)):
        return Blockwise(op).make_node(*inputs).outputs
    if all(x.ndim == ndim for x, ndim in zip(inputs, op.ndims, strict=True)):
        return op.make_node(*inputs).outputs
    rows, batch = as_rows(inputs[:n], op.ndims[:n])
    results = StructuralModes(op.family, batched=True).make_node(*rows, *constants).outputs
    if batch is None:
        return results
    return [x.reshape((*batch, *tuple(x.shape)[1:]), ndim=len(batch) + x.ndim - 1) for x in results]
