"""Memory of `derive`: structures in the lanes of vector registers, reached by addresses."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import write_number
from pymc_features.simulators.mean_squares.stencil import TAPS
from pymc_features.simulators.mean_squares.work import TURNS

VECTOR = 8 * LANES  # bytes
N_NUMBERS, N_FACTORS = 9, 16  # vectors for a pole
# Rows of a pole, complex numbers as two: E - 1 from output to output; sums of w times C v and C v'; C times
# what own values give, and v[N-1]; a number, of `pairs.own_size`; and then, as they stand in products of two
# modes, C times E X, phi2 and Q, and for each phase what stands before it and U. Their derivatives by lambda
# follow in the same order.
GROWN, TOTAL, SLOPE, OF_INPUT, END, SIZE, PRODUCTS = 0, 2, 4, 6, 8, 10, 11
LAST, NOW, HERE, PHASES = PRODUCTS, PRODUCTS + 2, PRODUCTS + 4, PRODUCTS + 6
AHEAD, BEFORE = 0, 2  # in a phase
OF_PHASE = 4  # rows


class Workspace(NamedTuple):
    """Addresses of vectors, and numbers; m poles, s sensors.

    Attributes
    ----------
    numbers : (9 m)
        Those of `Poles`, the turn of the node, and one over its spacing.
    scaled : (s m)
        S Phi Gamma.
    feed, factors, ends, starts : (s)
        Feed-through; derivatives of L by the sum of squares, times two, and by the last and first misfit.
    weights, slopes : (2 TAPS)
        Of the stencil, for one pole: of the functions and of their derivatives.
    found : (4 vectors)
        Interpolated functions of one pole of one structure.
    raw : (4 functions blocks)
        The same of one pole of all lanes: real and imaginary parts of function and derivative.
    given : (16)
        Factors of these, of one pole, see `poles.prepare`.
    modes : (n_rows m)
        See above.
    data, products : (s m)
        g_j'o_r, and sum_s S_js Gamma_s o_s'o_r.
    lag_zero : numbers
        R[0] of all functions.
    values, even, odd, slope_even, slope_odd : numbers
        Of mesh and stencil.
    early, first, last : numbers
        Of the sums.
    n_rows, derivatives : int
        Rows of a pole, and from a number of a product to its derivative.
    of_input : int
        Function of the own values of the input.
    """

    numbers: int
    scaled: int
    feed: int
    factors: int
    ends: int
    starts: int
    weights: int
    slopes: int
    found: int
    raw: int
    given: int
    modes: int
    data: int
    products: int
    lag_zero: int
    values: int
    even: int
    odd: int
    slope_even: int
    slope_odd: int
    data_squares: int
    data_products: int
    early: int
    first: int
    last: int
    step: float
    n_modes: int
    n_sensors: int
    stride: int
    n_functions: int
    of_input: int
    n_rows: int
    derivatives: int
    vectors: int
    blocks: int
    node: int
    square: float
    late: float
    second: float
    kick: float
    own_first: float
    own_last: float


def room_of(n_modes: int, n_sensors: int, table) -> np.ndarray:
    """Memory for `new_workspace`."""
    stride, (blocks, n_functions, _) = table.of.sums.first.size, table.of.lags.shape
    of_modes = (N_NUMBERS + rows_of(stride) + 3 * n_sensors) * n_modes
    of_functions = 4 * table.vectors + 4 * n_functions * blocks
    rows = of_modes + 4 * n_sensors + 4 * TAPS + of_functions + N_FACTORS
    return np.zeros((rows + 1) * LANES)


@jit
def rows_of(stride):
    """Rows of a pole."""
    return PRODUCTS + 2 * (PHASES - PRODUCTS + OF_PHASE * stride)


@jit
def new_workspace(room, mesh, sums, slopes, n_modes):
    """Workspace in a memory from `room_of`, of arrays that the caller keeps; `slopes` are two arrays."""
    n_sensors, vectors, stride = sums.squares.size, mesh.lag_zero.shape[0], sums.first.size
    n_functions = n_sensors + stride + (2 if sums.own_at else 1)
    blocks, n_rows = 2 if sums.first[0] != 0.0 else 1, rows_of(stride)
    numbers = (room.ctypes.data + VECTOR - 1) // VECTOR * VECTOR
    scaled = numbers + N_NUMBERS * n_modes * VECTOR
    of_shapes, of_sensors = n_sensors * n_modes * VECTOR, n_sensors * VECTOR
    feed = scaled + of_shapes
    weights = feed + 4 * of_sensors
    found = weights + 4 * TAPS * VECTOR
    raw = found + 4 * vectors * VECTOR
    given = raw + 4 * n_functions * blocks * VECTOR
    modes = given + N_FACTORS * VECTOR
    data = modes + n_rows * n_modes * VECTOR
    return Workspace(
        numbers,
        scaled,
        feed,
        feed + of_sensors,
        feed + 2 * of_sensors,
        feed + 3 * of_sensors,
        weights,
        weights + 2 * TAPS * VECTOR,
        found,
        raw,
        given,
        modes,
        data,
        data + of_shapes,
        mesh.lag_zero.ctypes.data,
        mesh.values.ctypes.data,
        mesh.even.ctypes.data,
        mesh.odd.ctypes.data,
        slopes[0].ctypes.data,
        slopes[1].ctypes.data,
        sums.squares.ctypes.data,
        sums.products.ctypes.data,
        sums.early.ctypes.data,
        sums.first.ctypes.data,
        sums.last.ctypes.data,
        mesh.step,
        n_modes,
        n_sensors,
        stride,
        n_functions,
        n_sensors + sums.own_at,
        n_rows,
        PHASES - PRODUCTS + OF_PHASE * stride,
        vectors,
        blocks,
        2 * blocks * vectors,
        sums.inputs[0, 0],
        sums.late[0, 0],
        sums.second[0],
        sums.kick[0],
        sums.own_first[0],
        sums.own_last[0],
    )


@jit
def fill_lane(own, lane, systems, poles, spacing, weights, p):
    """Write structure p into a lane; `spacing` (levels N_ROWS,) of the rows of the mesh."""
    m = own.n_modes
    for r in range(m):
        row = N_NUMBERS * r
        for i in range(6):
            write_number(own.numbers, (row + i) * LANES + lane, poles.numbers[p, r, i])
        turn = TURNS[poles.columns[p, r] % 6]
        write_number(own.numbers, (row + 6) * LANES + lane, turn.real)
        write_number(own.numbers, (row + 7) * LANES + lane, turn.imag)
        write_number(own.numbers, (row + 8) * LANES + lane, 1.0 / spacing[poles.rows[p, r]])
        for j in range(own.n_sensors):
            scaled = systems.shapes[p, j, r] * systems.participation[p, r, 0]
            write_number(own.scaled, (j * m + r) * LANES + lane, scaled)
    for j in range(own.n_sensors):
        at = j * LANES + lane
        write_number(own.feed, at, systems.feed[p, j, 0])
        write_number(own.factors, at, 2.0 * weights[p, j, 0])
        write_number(own.ends, at, weights[p, j, 1])
        write_number(own.starts, at, weights[p, j, 2])
