"""Modes of compilation for small graphs, and the Ops that a graph holds."""

from pytensor.compile.mode import Mode
from pytensor.graph.traversal import ancestors
from pytensor.tensor.blockwise import Blockwise

from pymc_features.ops import OPS

PLAIN = Mode(linker="py", optimizer=None)  # the Ops' own Python code, nothing rewritten
LIGHT = Mode(linker="py", optimizer="fast_compile")
REWRITTEN = Mode(linker="py", optimizer="fast_run")  # PyTensor's usual rewrites without machine code


def our_ops(variables):
    """Types of the Ops of this package in a graph, those inside Blockwise included."""
    ops = [v.owner.op for v in ancestors(variables) if v.owner is not None]
    return {type(op.core_op if isinstance(op, Blockwise) else op) for op in ops} & set(OPS)


def our_ops_of(function):
    """The same of a compiled function, of PyTensor or PyMC."""
    return our_ops(getattr(function, "f", function).maker.fgraph.outputs)
