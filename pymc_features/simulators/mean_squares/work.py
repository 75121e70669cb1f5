"""Memory of `evaluate`: structures in the lanes of vector registers."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.mean_squares.stencil import TAPS

TURNS = np.exp(1j * np.pi / 3.0 * np.arange(6))  # exp(i omega c) at the nodes, c the centre of time


class Work(NamedTuple):
    """Memory for the structures in the lanes.

    S poles, s sensors, d inputs with d c phases, complex numbers as two rows.

    Attributes
    ----------
    numbers : array (8 S, LANES)
        Those of `Poles`, and the turn of the node.
    shapes, participation, feed : array (S s, LANES), (S d, LANES), (s d, LANES)
    weights : array (2 TAPS, LANES)
        Of the stencil, for one pole.
    factors : array (4 d + 2, LANES)
        What stands before the interpolated functions and before R[0], of one pole; complex.
    grown, last : array (2 S, LANES)
        E - 1 from output to output, and C E X.
    ahead, before : array (2 S d c, LANES)
        C times what stands before the phases, by the participation, and C times U.
    now, here : array (2 S d, LANES)
        C times phi2, by the participation, and C times Q.
    found : array (2 vectors, LANES)
        The functions of one pole of one structure.
    products : array (s + 2 (functions - s), LANES)
        g'o, and C times Q, X and what own values give, of one pole.
    cross, squares, spread, ends : array (s, LANES)
        sum_r S_jr g_j'o_r, sum_rs S_jr S_js o_r'o_s, sum_r |S_jr| |o_r|, sum_r S_jr o_r[N-1].
    """

    numbers: np.ndarray
    shapes: np.ndarray
    participation: np.ndarray
    feed: np.ndarray
    weights: np.ndarray
    factors: np.ndarray
    grown: np.ndarray
    last: np.ndarray
    ahead: np.ndarray
    now: np.ndarray
    before: np.ndarray
    here: np.ndarray
    found: np.ndarray
    products: np.ndarray
    cross: np.ndarray
    squares: np.ndarray
    spread: np.ndarray
    ends: np.ndarray


@jit
def new_work(n_poles, n_sensors, sizes, vectors):
    """Memory for structures of one size; `sizes` are d and d c."""
    n_inputs, n_phases = sizes
    return Work(
        new_vectors(8 * n_poles),
        new_vectors(n_poles * n_sensors),
        new_vectors(n_poles * n_inputs),
        new_vectors(n_sensors * n_inputs),
        new_vectors(2 * TAPS),
        new_vectors(4 * n_inputs + 2),
        new_vectors(2 * n_poles),
        new_vectors(2 * n_poles),
        new_vectors(2 * n_poles * n_phases),
        new_vectors(2 * n_poles * n_inputs),
        new_vectors(2 * n_poles * n_phases),
        new_vectors(2 * n_poles * n_inputs),
        new_vectors(2 * vectors),
        new_vectors(n_sensors + 2 * (n_phases + n_inputs + 1)),
        new_vectors(n_sensors),
        new_vectors(n_sensors),
        new_vectors(n_sensors),
        new_vectors(n_sensors),
    )


class Addresses(NamedTuple):
    """Where arrays of `Mesh`, `Sums` and `Work` begin, and their sizes.

    As arguments of the innermost functions the arrays would take longer, by their reference counts, than what
    is done with them.

    Attributes
    ----------
    values, even, odd, lag_zero : int
        Of the mesh.
    data_squares, data_products, inputs, early, late, first, final, second, kick : int
        Of the sums; `final` are the last samples.
    numbers ... ends : int
        Of the memory.
    step : float
        h [s].
    n_sensors, n_inputs, stride, n_functions : int
        s, d, c, and functions behind those of data.
    own, own_step : int
        Which of them is that of own values of the first input, and how many lie to the next.
    vectors : int
        For the functions of one input.
    blocks : int
        Inputs, and one more if some do not begin with zero.
    node : int
        Vectors from one node to the next.
    """

    values: int
    even: int
    odd: int
    lag_zero: int
    data_squares: int
    data_products: int
    inputs: int
    early: int
    late: int
    first: int
    final: int
    second: int
    kick: int
    numbers: int
    shapes: int
    participation: int
    feed: int
    weights: int
    factors: int
    grown: int
    last: int
    ahead: int
    now: int
    before: int
    here: int
    found: int
    products: int
    cross: int
    squares: int
    spread: int
    ends: int
    step: float
    n_sensors: int
    n_inputs: int
    stride: int
    n_functions: int
    own: int
    own_step: int
    vectors: int
    blocks: int
    node: int


@jit
def addresses(mesh, sums, work):
    """Addresses of arrays that the caller keeps."""
    (n_sensors, n_inputs), n_phases = sums.products.shape, sums.first.size
    vectors, blocks, stride = mesh.lag_zero.shape[0] // n_inputs, n_inputs, n_phases // n_inputs
    for i in range(n_inputs):
        if sums.first[i * stride] != 0.0:
            blocks = n_inputs + 1
    n_own, own_step = (n_inputs, 1) if sums.own_at else (0, stride)
    return Addresses(
        mesh.values.ctypes.data,
        mesh.even.ctypes.data,
        mesh.odd.ctypes.data,
        mesh.lag_zero.ctypes.data,
        sums.squares.ctypes.data,
        sums.products.ctypes.data,
        sums.inputs.ctypes.data,
        sums.early.ctypes.data,
        sums.late.ctypes.data,
        sums.first.ctypes.data,
        sums.last.ctypes.data,
        sums.second.ctypes.data,
        sums.kick.ctypes.data,
        work.numbers.ctypes.data,
        work.shapes.ctypes.data,
        work.participation.ctypes.data,
        work.feed.ctypes.data,
        work.weights.ctypes.data,
        work.factors.ctypes.data,
        work.grown.ctypes.data,
        work.last.ctypes.data,
        work.ahead.ctypes.data,
        work.now.ctypes.data,
        work.before.ctypes.data,
        work.here.ctypes.data,
        work.found.ctypes.data,
        work.products.ctypes.data,
        work.cross.ctypes.data,
        work.squares.ctypes.data,
        work.spread.ctypes.data,
        work.ends.ctypes.data,
        mesh.step,
        n_sensors,
        n_inputs,
        stride,
        n_phases + 1 + n_own,
        sums.own_at,
        own_step,
        vectors,
        blocks,
        2 * blocks * vectors,
    )


@jit
def fill_lane(work, lane, systems, poles, p):
    """Write structure p into a lane."""
    m, (n_sensors, n_inputs) = systems.omega.shape[1], systems.feed.shape[1:]
    for r in range(poles.numbers.shape[1]):
        for i in range(6):
            work.numbers[8 * r + i, lane] = poles.numbers[p, r, i]
        turn = TURNS[poles.columns[p, r] % 6]
        work.numbers[8 * r + 6, lane], work.numbers[8 * r + 7, lane] = turn.real, turn.imag
        for j in range(n_sensors):
            work.shapes[r * n_sensors + j, lane] = systems.shapes[p, j, r % m]
        for i in range(n_inputs):
            work.participation[r * n_inputs + i, lane] = systems.participation[p, r % m, i]
    for j in range(n_sensors):
        for i in range(n_inputs):
            work.feed[j * n_inputs + i, lane] = systems.feed[p, j, i]
