"""How functions that are called a few thousand times are compiled."""

import pytensor
import pytensor.tensor as pt
from pytensor.compile.mode import Mode
from pytensor.graph.rewriting.basic import dfs_rewriter, node_rewriter
from pytensor.graph.traversal import ancestors
from pytensor.scalar import Add, Mul, Softplus
from pytensor.scan.op import Scan
from pytensor.tensor.basic import Alloc
from pytensor.tensor.blockwise import Blockwise
from pytensor.tensor.elemwise import Elemwise
from pytensor.tensor.random.op import RandomVariable

WIDEST = 16  # operands of a sum or product; a ufunc of NumPy takes 31


@node_rewriter([Elemwise])
def split_sums(fgraph, node):
    """Wide sums and products in parts: the slope of forty storeys by what they share has forty summands."""
    operands = node.inputs
    if not isinstance(node.op.scalar_op, Add | Mul) or len(operands) <= WIDEST:
        return None
    first = node.op(*operands[:WIDEST])
    return [node.op(first, *operands[WIDEST:])]


@node_rewriter([Elemwise])
def softplus_by_numpy(fgraph, node):
    """ln(1 + exp(x)) by functions of NumPy, which has none: PyTensor would call Python for each number."""
    if not isinstance(node.op.scalar_op, Softplus):
        return None
    (x,) = node.inputs
    return [pt.maximum(x, 0.0) + pt.log1p(pt.exp(-pt.abs(x)))]


# NumPy calls for everything around the kernels, which are machine code in any mode. Numba would compile the
# whole graph: twenty seconds for value and gradient of a new model, to save half a millisecond of a call.
# Sums are split, and logarithms written out, after all rewrites that would join them again.
INTERPRETED = (
    Mode(linker="py", optimizer="fast_run")
    .excluding("fusion")
    .register((dfs_rewriter(split_sums), 49.2), (dfs_rewriter(softplus_by_numpy), 49.2))
)


def with_mode(compile_kwargs: dict, outputs) -> dict:
    """Arguments of `pytensor.function` with a mode; that of the user or of PyTensor's flags comes first.

    By default NumPy evaluates what is between the kernels, unless something there would be a loop in Python.
    """
    chosen = "mode" in compile_kwargs or (pytensor.config.mode, pytensor.config.linker) != ("Mode", "auto")
    if chosen or has_python_loops(outputs):
        return compile_kwargs
    return compile_kwargs | {"mode": INTERPRETED}


def has_python_loops(outputs) -> bool:
    """Whether NumPy would be called once for each particle or step."""
    owners = {v.owner for v in ancestors(outputs) if v.owner is not None}
    return any(is_loop(node) for node in owners)


def is_loop(node) -> bool:
    """Whether a node is a loop over particles or steps that takes longer in Python than what it calls."""
    op = node.op
    if isinstance(op, Scan):
        return True
    if (
        not isinstance(op, Blockwise)
        or isinstance(op.core_op, RandomVariable | Alloc)
        or op.batch_ndim(node) == 0
    ):
        return False
    spec = op.gufunc_spec or getattr(op.core_op, "gufunc_spec", None)
    return spec is None and not type(op.core_op).__module__.startswith("pymc_features.")
