"""The graph of log prior and log-likelihood of a model: of one particle, and of a whole population."""

from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from pymc.distributions.simulator import SimulatorRV
from pymc.logprob.utils import local_check_parameter_to_ninf_switch, local_remove_check_parameter
from pymc.pytensorf import join_nonshared_inputs
from pytensor.compile import optdb
from pytensor.compile.ops import DeepCopyOp, ViewOp
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant, Variable
from pytensor.graph.fg import FunctionGraph
from pytensor.graph.replace import vectorize_graph
from pytensor.graph.rewriting.basic import dfs_rewriter
from pytensor.graph.rewriting.db import RewriteDatabaseQuery
from pytensor.graph.traversal import ancestors, io_toposort
from pytensor.raise_op import CheckAndRaise
from pytensor.tensor.basic import Alloc, Join, MakeVector, ScalarFromTensor, Split, TensorFromScalar
from pytensor.tensor.blockwise import Blockwise
from pytensor.tensor.elemwise import CAReduce, DimShuffle, Elemwise
from pytensor.tensor.random.type import RandomGeneratorType
from pytensor.tensor.shape import Reshape, Shape, Shape_i, SpecifyShape
from pytensor.tensor.subtensor import AdvancedIncSubtensor, AdvancedSubtensor, IncSubtensor, Subtensor
from pytensor.tensor.type import TensorType

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
    for op in simulator_functions(nodes_of(outputs)):
        if not getattr(op.fn, "batched", False):
            return (
                f"the function of {op.name} takes one set of parameters at a time. If it accepts a "
                "leading particle dimension, say so by `function.batched = True`"
            )
    return None


def nodes_of(outputs) -> set:
    """All nodes of a graph."""
    return {v.owner for v in ancestors(outputs) if v.owner is not None}


def simulator_functions(nodes) -> list:
    """Find the Ops of nodes that call a simulator function."""
    return [node.op for node in nodes if isinstance(node.op, SimulatorRV)]


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


class Outputs(NamedTuple):
    """Outputs of a graph and the one tensor that they depend on, besides data.

    Attributes
    ----------
    joined : Variable (d,) or (p, d)
        The parameters of one particle, or of all.
    outputs : list of Variable
        Log prior, log-likelihood, and what else is asked for: scalars, or (p,).
    """

    joined: Variable
    outputs: list


class DensityGraph(NamedTuple):
    """Log prior and log-likelihood of a model.

    Attributes
    ----------
    one : Outputs
        Of one particle (d,). Where simulators are inside, a third says whether one of them failed.
    population : Outputs or None
        The same of particles (p, d); None if a part of the model takes no batch.
    why_not_batched : str
        What part that is; empty if there is none.
    """

    one: Outputs
    population: Outputs | None
    why_not_batched: str

    @property
    def counts_simulations(self) -> bool:
        """Whether a third output says if a simulator failed."""
        return len(self.one.outputs) > 2


def batched_graph(one: Outputs) -> DensityGraph:
    """Make the graph one of a whole population, where no part of it refuses."""
    if (reason := why_not_batched(one.outputs)) is not None:
        return DensityGraph(one, None, reason)
    particles = pt.matrix("particles", dtype=one.joined.dtype)
    try:
        outputs = vectorize_graph(one.outputs, {one.joined: particles})
    except Exception as error:  # any Op of any library may refuse in its own way
        return DensityGraph(one, None, f"a part of the model cannot be vectorised ({error})")
    rows = particles.shape[0]
    outputs = [out if out.ndim else pt.broadcast_to(out, (rows,)) for out in outputs]
    return DensityGraph(one, Outputs(particles, outputs), "")


def joined_graph(model, point, outputs: list, inputs: list) -> Outputs:
    """Log prior, log-likelihood and, if simulators are inside, whether one failed, of one vector.

    Parameter checks become -inf here, before any vectorisation: afterwards one particle outside would take
    all with it.
    """
    graph = FunctionGraph(outputs=outputs, clone=True, copy_inputs=False)
    optdb.query(RewriteDatabaseQuery(include=["fuse_likelihood"])).rewrite(graph)
    check = local_check_parameter_to_ninf_switch if model.check_bounds else local_remove_check_parameter
    dfs_rewriter(check).rewrite(graph)
    outputs = list(graph.outputs)
    failures = [
        pt.any(pt.isnan(out) | pt.isinf(out))
        for node in nodes_of(outputs)
        if getattr(core_op(node), "simulates", isinstance(node.op, SimulatorRV))
        for out in node.outputs
        if isinstance(out.type, TensorType)
    ]
    if failures:
        failed = failures[0]
        for more in failures[1:]:
            failed = failed | more
        outputs.append(failed)
    outputs, vector = join_nonshared_inputs(point, outputs, inputs)
    return Outputs(vector, outputs)


def largest_result(inputs, outputs) -> int:
    """Number of entries of the largest result, final or intermediate, that depends on the inputs."""
    sources = [
        v
        for v in ancestors(outputs)
        if isinstance(v, Constant | SharedVariable) and isinstance(v.type, TensorType)
    ]
    unknown = 1  # stands for a length that is not known before the call: no longer than the longest data
    for v in sources:
        value = v.data if isinstance(v, Constant) else v.get_value(borrow=True)
        unknown = max([unknown, *np.shape(value)])
    depends = set(inputs)
    largest = 1
    for node in io_toposort(inputs, outputs):
        if depends.isdisjoint(node.inputs):
            continue
        depends.update(node.outputs)
        for v in node.outputs:
            shape = getattr(v.type, "shape", ())
            largest = max(largest, int(np.prod([unknown if n is None else n for n in shape], dtype=float)))
    return largest
