"""What the response Ops share: their inputs, and what a gradient depends on."""

import re
from functools import cached_property, reduce

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Constant, Variable
from pytensor.graph.op import Op

from pymc_features.simulators import CODES, FAMILIES, n_outputs
from pymc_features.simulators.families import count
from pymc_features.simulators.linear.known import KNOWN


class StructuralOp(Op):
    """Base of the Ops on structures.

    Parameters
    ----------
    quantity : str
        A key of `simulators.CODES`.
    family : str
        A key of `simulators.FAMILIES`; it fixes the inputs. Everything else the kernels read is an input of
        the node, so that equal Ops always do the same.

    Attributes
    ----------
    kernel_name : str
        Which of the family's kernels it runs.
    more_signature, output_signature : str
        Shapes of what comes behind the family's inputs, and of the outputs; "parameters" stands for those of
        the parameters.
    takes_directions : bool
        Whether a direction of each parameter comes last.
    batched : bool
        Whether each parameter has a row for each particle.
    """

    __props__ = ("quantity", "family")
    kernel_name: str
    more_signature = ""
    output_signature: str
    takes_directions = False
    batched = False

    def __init__(self, quantity: str = "absolute_acceleration", family: str = "chain"):
        self.quantity, self.family = quantity, family  # all else follows: machine code on disk holds Ops

    @property
    def spec(self):
        """The family: no attribute, for machine code does not travel with pickled Ops."""
        return FAMILIES[self.family]

    @property
    def quantity_code(self) -> int:
        """The quantity, as the kernels call it."""
        return CODES[self.quantity]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the family's inputs."""
        return tuple(self.inputs)

    @cached_property
    def n_parameters(self) -> int:
        """Number of parameters, the first inputs."""
        return len(self.spec.parameters)

    @cached_property
    def n_common(self) -> int:
        """Number of the family's inputs."""
        return len(self.names)

    @property
    def inputs(self) -> dict[str, str]:
        """Names and shapes of the family's inputs."""
        return self.spec.inputs

    @property
    def kernel(self):
        """Arrays in, an array or a tuple of arrays out."""
        return self.spec.kernels[self.kernel_name]

    @property
    def gufunc_signature(self):
        """Shapes of inputs and outputs of one particle; the Op of a population is never wrapped."""
        if self.batched:
            return None
        common, of_parameters = shapes(self.inputs), shapes(self.spec.parameters)
        more = f",{self.more_signature}" if self.more_signature else ""
        return f"{common}{more}->{self.output_signature}".replace("parameters", of_parameters)

    @property
    def more_ndims(self) -> tuple[int, ...]:
        """Numbers of dimensions of the inputs behind the family's."""
        more = self.more_signature.replace("parameters", shapes(self.spec.parameters))
        return tuple(count(dims) for dims in re.findall(r"\(([^)]*)\)", more))

    @property
    def parameter_ndims(self) -> tuple[int, ...]:
        """Numbers of dimensions of the parameters of one structure."""
        return tuple(count(dims) for dims in self.spec.parameters.values())

    def dtype(self, name: str) -> str:
        """Type of an input."""
        return self.spec.dtype(name)

    def at(self, name: str) -> int:
        """Position of an input."""
        return self.names.index(name)

    def like(self, op_type, **changes) -> "StructuralOp":
        """Return another Op on the same quantity and family."""
        return op_type(self.quantity, self.family, **changes)

    def prepare_inputs(self, inputs, start=0):
        """Cast the family's inputs from number `start` on, and check their numbers of dimensions."""
        prepared = []
        for (name, dims), value in zip(list(self.inputs.items())[start:], inputs, strict=True):
            dtype, ndim = self.dtype(name), count(dims) + (self.batched and name in self.spec.parameters)
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

    def static_n_sensors(self, inputs) -> int | None:
        """Number of sensors where it is known when the graph is built."""
        return inputs[self.at("sensors")].type.shape[0]

    def static_n_outputs(self, inputs) -> int | None:
        """Number of output samples where record and step are known when the graph is built."""
        n_times = inputs[self.at("acceleration")].type.shape[-1]
        substeps, stride = inputs[self.at("substeps")], inputs[self.at("stride")]
        if n_times is None or not (isinstance(substeps, Constant) and isinstance(stride, Constant)):
            return None
        return int(n_outputs(n_times, int(substeps.data), int(stride.data)))

    def symbolic_n_outputs(self, node, shapes):
        """Number of output samples as a tensor."""
        substeps, stride = node.inputs[self.at("substeps")], node.inputs[self.at("stride")]
        return ((shapes[self.at("acceleration")][-1] - 1) * substeps) // stride + 1

    def population(self, shapes) -> tuple:
        """Number of particles as a tensor, if parameters have a row for each or one for all; else nothing."""
        rows = [shape[0] for shape in shapes[: self.n_parameters]]
        return (reduce(pt.maximum, rows),) if self.batched else ()

    def prepare_node(self, node, storage_map, compute_map, impl):
        """Forget what other functions have learnt, as `numba_dispatch.in_python` does."""
        KNOWN.forget()

    def perform(self, node, inputs, output_storage):
        results = self.run(inputs)
        for storage, result in zip(output_storage, results, strict=True):
            storage[0] = result

    def run(self, inputs) -> tuple[np.ndarray, ...]:
        """What the kernel makes of arrays."""
        results = self.kernel(*self.arguments(inputs))
        return results if isinstance(results, tuple) else (results,)

    def arguments(self, inputs) -> tuple:
        """Arguments of the kernel, from the arrays of a node."""
        arrays = [prepared(x) for x in inputs]
        arguments = self.spec.assemble(arrays[: self.n_common], self.quantity_code)
        more, directions = self.split(arrays[self.n_common :])
        return *arguments, *more, *directions

    def split(self, more):
        """What follows the family's inputs, and a tuple with the tuple of directions if there are any."""
        if not self.takes_directions:
            return more, ()
        first = len(more) - self.n_parameters
        return more[:first], (tuple(more[first:]),)

    def connection_pattern(self, node):
        """Parameters and data count; constants, the record, the sampling and the sensors do not."""
        counts = [i < self.n_parameters or i >= self.n_common for i in range(len(node.inputs))]
        return [[c] * len(node.outputs) for c in counts]


def prepared(x):
    """An array, or a number of an array without dimensions, as the kernels take it.

    Arrays that may not be written are copied: Numba would compile the kernels for these once more.
    """
    return np.require(x, requirements=["C", "W"]) if np.ndim(x) else x.item()


def shapes(inputs: dict[str, str]) -> str:
    """Shapes of inputs as a gufunc signature has them."""
    return ",".join(f"({dims})" for dims in inputs.values())


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
