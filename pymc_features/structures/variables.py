"""PyTensor variables as parameters: what counts as one, and the lengths that a model knows."""

from collections.abc import Sequence

import numpy as np
import pytensor.tensor as pt
from pytensor.compile.mode import Mode
from pytensor.graph.basic import Constant, Variable
from pytensor.graph.fg import FunctionGraph
from pytensor.graph.traversal import ancestors
from pytensor.tensor import TensorType
from pytensor.tensor.random.op import RandomVariable
from pytensor.tensor.rewriting.shape import ShapeFeature
from pytensor.xtensor.type import XTensorVariable

from pymc_features._checks import as_numbers, message

NUMBERS = "numbers or PyTensor variables"
PLAIN = Mode(linker="py", optimizer=None)  # nothing to compile


def unpacked(value):
    """Arrays that hold variables as lists, variables of `pymc.dims` as tensors, anything else as it is."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value.tolist()
    return value.values if isinstance(value, XTensorVariable) else value


def holds_variables(value) -> bool:
    """Whether a value is a sequence, and an entry of it is a variable."""
    return isinstance(value, Sequence) and any(isinstance(entry, Variable) for entry in value)


def as_tensor(value, name: str, advice: str = ""):
    """A float64 tensor from a variable, from numbers or from a list of both; refuse what holds no numbers."""
    value = unpacked(value)
    if isinstance(value, Variable):
        return as_float_tensor(value, name, advice)
    if holds_variables(value):
        return stacked(value, name, advice)
    return pt.as_tensor_variable(as_numbers(value, name, advice, what=NUMBERS))


def as_float_tensor(variable, name: str, advice: str = ""):
    """A variable as a float64 tensor; refuse what has no real numbers."""
    kind = variable.type
    if not isinstance(kind, TensorType) or kind.dtype.startswith(("complex", "bool")):
        got = f"a PyTensor variable of type {kind}"
        raise TypeError(message(name, "real numbers", got, advice))
    if isinstance(variable, Constant):  # a cast of it would be none
        return pt.as_tensor_variable(np.asarray(variable.data, dtype=np.float64))
    return variable.astype("float64")


def stacked(entries, name: str, advice: str = ""):
    """Numbers and variables of one number of dimensions as a float64 tensor; its first axis counts them."""
    tensors = [as_tensor(entry, name, advice) for entry in entries]
    if len({tensor.ndim for tensor in tensors}) > 1:
        raise ValueError(
            f"`{name}` must be a list of scalars, got a vector among them. "
            "Pass a vector by itself, or join several by `pt.concatenate`."
        )
    return pt.stack(tensors)


def with_known_length(tensor):
    """A vector with its length in its type where the graph fixes it, as that of `dims` of a model does."""
    if tensor.ndim != 1 or tensor.type.shape[0] is not None:
        return tensor
    length = computed_length(tensor)
    if length is None:
        return tensor
    known = pt.specify_shape(tensor, (length,))
    known.name = tensor.name
    return known


def computed_length(vector) -> int | None:
    """Length of a vector by the constants and data of its graph; None if inputs or draws decide it."""
    graph = FunctionGraph(outputs=[vector], clone=True, features=[ShapeFeature()])
    length = graph.shape_feature.get_shape(graph.outputs[0], 0)
    for variable in ancestors([length]):
        if variable.owner is None:
            if not hasattr(variable, "data") and not hasattr(variable, "get_value"):
                return None
        elif isinstance(variable.owner.op, RandomVariable):
            return None
    return int(length.eval(mode=PLAIN))
