"""PyTensor variables as parameters: what counts as one, and the lengths that a model knows."""

from collections.abc import Sequence

import numpy as np
import pytensor.tensor as pt
from pytensor.compile.mode import Mode
from pytensor.graph.basic import Variable
from pytensor.graph.fg import FunctionGraph
from pytensor.graph.traversal import ancestors
from pytensor.tensor.random.op import RandomVariable
from pytensor.tensor.rewriting.shape import ShapeFeature
from pytensor.xtensor.type import XTensorVariable

PLAIN = Mode(linker="py", optimizer=None)  # nothing to compile


def unpacked(value):
    """Arrays that hold variables as lists, variables of `pymc.dims` as tensors, anything else as it is."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value.tolist()
    return value.values if isinstance(value, XTensorVariable) else value


def holds_variables(value) -> bool:
    """Whether a value is a sequence, and an entry of it is a variable."""
    return isinstance(value, Sequence) and any(isinstance(entry, Variable) for entry in value)


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
