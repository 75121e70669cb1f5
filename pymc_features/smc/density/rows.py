"""A compiled function of particles, called for as many at once as memory allows."""

import threading
import warnings
from contextlib import contextmanager

import numpy as np
import pytensor
import pytensor.tensor as pt
from pymc.pytensorf import compile as compile_function
from pytensor import shared as make_shared
from pytensor.compile.mode import Mode
from pytensor.graph.rewriting.basic import dfs_rewriter, node_rewriter
from pytensor.scalar import Add, Mul, Softplus
from pytensor.scan.op import Scan
from pytensor.tensor.basic import Alloc
from pytensor.tensor.blockwise import Blockwise
from pytensor.tensor.elemwise import Elemwise
from pytensor.tensor.random.op import RandomVariable
from pytensor.tensor.random.type import RandomGeneratorType

from pymc_features.simulators.linear.known import KNOWN
from pymc_features.smc.density.graph import (
    DensityGraph,
    goes_row_by_row,
    largest_result,
    nodes_of,
    simulator_functions,
)

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
    return any(map(is_loop, nodes_of(outputs)))


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


BATCH_BYTES = 2**26  # of the largest intermediate result of one call; larger populations are split
UNIT = 8  # particles of a group in our kernels, or two groups: a population is cut at multiples of it
LEARNS_FROM, SETTLED = 32, 8  # particles of a call, and calls in turn, after which nothing new is expected
TOGETHER = 128  # particles of simulations in a call where a row may depend on how many others there are

# Compiled functions have memory of their own: where several chains run in threads, one at a time.
ONE_CALL = threading.RLock()

# what a model function may raise at bad parameters; the particle at fault is then found and set aside
NUMERICAL_ERRORS = (ArithmeticError, np.linalg.LinAlgError)


@contextmanager
def quiet_about_python():
    """Suppress the warning that a simulator function runs in Python: it always does."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Numba will use object mode", category=UserWarning)
        yield


class RowFunction:
    """Outputs of a graph for particles (p, d).

    Parameters
    ----------
    graph : DensityGraph
    compile_kwargs : dict
        For `pytensor.function`.
    alive : int
        How many results of the size of the largest are in memory at once; the batch is that much smaller.

    Attributes
    ----------
    batched : bool
        False if it is called for each particle by itself.
    batch : int
        Particles in one call, at most.
    unit : int
        No bit of a result changes where a population is cut at multiples of it, and no part is smaller.
    raised : str
        What the model raised last; empty if nothing did.
    bases : tuple of Known, or None
        In which modes of large sparse structures are looked for, see `learn`.
    """

    def __init__(self, graph: DensityGraph, compile_kwargs: dict, alive: int = 1):
        self.raised, self.bases = "", None
        self.batched = graph.population is not None
        self.batch = max(
            1, BATCH_BYTES // (8 * alive * largest_result([graph.one.joined], graph.one.outputs))
        )
        self.errors = Exception if simulator_functions(nodes_of(graph.one.outputs)) else NUMERICAL_ERRORS
        joined, outputs = graph.population if self.batched else graph.one
        kwargs = with_mode(compile_kwargs, outputs) if self.batched else compile_kwargs
        with quiet_about_python():
            self.function = compile_function([joined], outputs, **{**kwargs, "on_unused_input": "ignore"})
        self.function.trust_input = True
        if not self.batched:
            self.batch = self.unit = 1
        elif kwargs.get("mode") is INTERPRETED and goes_row_by_row(self.function):
            # compiled by Numba, a loop treats its last rows by other instructions
            self.unit = min(UNIT, self.batch)
            self.batch -= self.batch % self.unit
        else:
            self.batch = self.unit = min(self.batch, TOGETHER) if graph.counts_simulations else self.batch

    def __call__(self, particles: np.ndarray) -> list[np.ndarray]:
        """Outputs (p, ...); NaN for particles at which the model raises a numerical error."""
        ends = [*range(self.batch, len(particles) - self.unit + 1, self.batch), len(particles)]
        with ONE_CALL, KNOWN.only(self.bases):
            parts = [self._evaluate(particles[i:k]) for i, k in zip([0, *ends], ends, strict=False)]
        return [np.concatenate(column) for column in zip(*parts, strict=True)]

    def has_large_structures(self, start: np.ndarray) -> bool:
        """Call the function at one particle (1, d), and say whether `learn` makes bases for it."""
        with ONE_CALL, KNOWN.learning():
            self(start)
            return len(KNOWN.entries) > 0

    def learn(self, particles: np.ndarray) -> None:
        """Make bases for the modes of large sparse structures, from particles (n, d) all over the prior.

        No result depends from then on on those before, nor on the process.
        """
        with ONE_CALL, KNOWN.learning():
            without_news = 0
            for first in range(0, len(particles), LEARNS_FROM):
                before = sum(known.solved for known in KNOWN.entries)
                self(particles[first : first + LEARNS_FROM])
                is_new = sum(known.solved for known in KNOWN.entries) > before
                without_news = 0 if is_new else without_news + 1
                if without_news == SETTLED or all(known.is_given_up for known in KNOWN.entries):
                    break
            self.bases = KNOWN.fix()

    def _evaluate(self, particles):
        try:
            if self.batched:
                return self.function(np.ascontiguousarray(particles))
            return [np.asarray(out)[None] for out in self.function(particles[0])]
        except self.errors as error:
            n, d = particles.shape
            if n == 1:
                self.raised = f"{type(error).__name__}: {str(error).partition('\n')[0]}"
                outputs = [out for out in self.function.maker.fgraph.outputs if hasattr(out, "ndim")]
                return [np.full((1, d)[: out.ndim + (not self.batched)], np.nan) for out in outputs]
            half = max(n // 2 // self.unit, 1) * self.unit if n > self.unit else n // 2
            halves = self._evaluate(particles[:half]), self._evaluate(particles[half:])
            return [np.concatenate(pair) for pair in zip(*halves, strict=True)]

    def with_rng(self, rng: np.random.Generator) -> "RowFunction":
        """Take random streams of its own; return this one if there are no random draws in it."""
        shared = [v for v in self.function.get_shared() if isinstance(v.type, RandomGeneratorType)]
        if not shared:
            return self
        streams = rng.spawn(len(shared))
        swap = {old: make_shared(new, borrow=True) for old, new in zip(shared, streams, strict=True)}
        with quiet_about_python():
            function = self.function.copy(swap=swap)
        other = object.__new__(RowFunction)
        other.__setstate__({**self.__dict__, "function": function})
        return other

    def __setstate__(self, state):
        self.__dict__.update(state)
        self.function.trust_input = True
