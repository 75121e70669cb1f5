"""Which simulators and which random draws a graph has inside."""

from pymc.distributions.simulator import SimulatorRV
from pytensor.compile.ops import DeepCopyOp, ViewOp
from pytensor.graph.traversal import ancestors
from pytensor.raise_op import CheckAndRaise
from pytensor.tensor.basic import Alloc, Join, MakeVector, ScalarFromTensor, Split, TensorFromScalar
from pytensor.tensor.blockwise import Blockwise
from pytensor.tensor.elemwise import CAReduce, DimShuffle, Elemwise
from pytensor.tensor.random.type import RandomGeneratorType
from pytensor.tensor.shape import Reshape, Shape, Shape_i, SpecifyShape
from pytensor.tensor.subtensor import AdvancedIncSubtensor, AdvancedSubtensor, IncSubtensor, Subtensor

# What NumPy computes of each row by itself, in the same way whatever the number of rows; a product of
# matrices is none of them. So do the Ops of this package.
ROW_BY_ROW = (
    Elemwise,
    DimShuffle,
    CAReduce,
    Alloc,
    Join,
    Split,
    MakeVector,
    ScalarFromTensor,
    TensorFromScalar,
    Reshape,
    Shape,
    Shape_i,
    SpecifyShape,
    Subtensor,
    IncSubtensor,
    AdvancedSubtensor,
    AdvancedIncSubtensor,
    ViewOp,
    DeepCopyOp,
    CheckAndRaise,
)


def core_op(node):
    """The Op of a node, without the wrapping of batches."""
    return node.op.core_op if isinstance(node.op, Blockwise) else node.op


def why_not_batched(outputs) -> str | None:
    """Say which part of the graph takes one set of parameters at a time; None if there is none."""
    for op in simulator_functions(outputs):
        if not getattr(op.fn, "batched", False):
            return (
                f"the function of {op.name} takes one set of parameters at a time. If it accepts a "
                "leading particle dimension, say so by `function.batched = True`"
            )
    return None


def simulator_functions(outputs) -> list:
    """Ops of the graph that call a simulator function."""
    owners = {v.owner for v in ancestors(outputs) if v.owner is not None}
    return [node.op for node in owners if isinstance(node.op, SimulatorRV)]


def simulators_inside(graph) -> list:
    """Ops of a compiled graph that call a simulator function."""
    return [node.op for node in inner_nodes(graph) if isinstance(node.op, SimulatorRV)]


def inner_nodes(graph):
    """Nodes of a compiled graph, also where PyTensor has wrapped them."""
    for node in graph.apply_nodes:
        yield node
        if getattr(node.op, "fgraph", None) is not None:
            yield from inner_nodes(node.op.fgraph)


def is_random(node) -> bool:
    """Whether a node draws random numbers; simulators of ours get a generator and say that they do not."""
    op = core_op(node)
    if isinstance(op, SimulatorRV) and not getattr(op.fn, "draws_random_numbers", True):
        return False
    inside = getattr(op, "fgraph", None) is not None  # its own nodes tell
    return not inside and any(isinstance(v.type, RandomGeneratorType) for v in node.inputs)


def goes_row_by_row(function) -> bool:
    """Whether the rows of what NumPy evaluates are known not to depend on the number of rows.

    To the last bit: a product of matrices sums in another order for another number of rows.
    """
    graph = function.maker.fgraph
    depends = set(graph.inputs[:1])
    for node in graph.toposort():
        if depends.isdisjoint(node.inputs):
            continue
        depends.update(node.outputs)
        ours = type(core_op(node)).__module__.startswith("pymc_features.")
        if not (isinstance(node.op, ROW_BY_ROW) or ours) or is_random(node):
            return False
    return True
