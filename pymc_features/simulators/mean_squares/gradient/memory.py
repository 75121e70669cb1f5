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
# Rows of a pole, complex numbers as two: C times E X, rho, phi2, U and Q, as they stand in products of two
# modes, and the same of their derivatives by lambda; E - 1; sums of w times C v and C v'; C times a'v and
# v[N-1]; and a number, of `pairs.own_size`
LAST, AHEAD, NOW, BEFORE, HERE, DERIVATIVES = 0, 2, 4, 6, 8, 10
GROWN, TOTAL, SLOPE, OF_INPUT, END, SIZE = 20, 22, 24, 26, 28, 30
N_ROWS = 31


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
    raw : (4 (s + 2) blocks)
        The same of one pole of all lanes: real and imaginary parts of function and derivative.
    given : (16)
        Factors of these, of one pole, see `poles.prepare`.
    modes : (N_ROWS m)
        See above.
    data, products : (s m)
        g_j'o_r, and sum_s S_js Gamma_s o_s'o_r.
    of_input : (s)
        dL/dy_j times the input, summed over time.
    spread : (s)
        As in `Work`.
    lag_zero : (s + 2) numbers
        R[0] of all functions.
    values, even, odd, slope_even, slope_odd : numbers
        Of mesh and stencil.
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
    of_input: int
    spread: int
    lag_zero: int
    values: int
    even: int
    odd: int
    slope_even: int
    slope_odd: int
    data_squares: int
    data_products: int
    step: float
    n_modes: int
    n_sensors: int
    vectors: int
    blocks: int
    node: int
    square: float
    early: float
    late: float
    first: float
    last: float
    second: float
    kick: float


def room_of(n_modes: int, n_sensors: int, vectors: int, blocks: int) -> np.ndarray:
    """Memory for `new_workspace`."""
    of_modes = (N_NUMBERS + N_ROWS + 3 * n_sensors) * n_modes
    rows = of_modes + 6 * n_sensors + 4 * TAPS + 4 * vectors + 4 * (n_sensors + 2) * blocks + N_FACTORS
    return np.zeros((rows + 1) * LANES)


@jit
def new_workspace(room, mesh, sums, slopes, n_modes, blocks):
    """Workspace in a memory from `room_of`, of arrays that the caller keeps; `slopes` are two arrays."""
    n_sensors, vectors = sums.squares.size, mesh.lag_zero.shape[0]
    numbers = (room.ctypes.data + VECTOR - 1) // VECTOR * VECTOR
    scaled = numbers + N_NUMBERS * n_modes * VECTOR
    of_shapes, of_sensors = n_sensors * n_modes * VECTOR, n_sensors * VECTOR
    feed = scaled + of_shapes
    weights = feed + 4 * of_sensors
    found = weights + 4 * TAPS * VECTOR
    raw = found + 4 * vectors * VECTOR
    given = raw + 4 * (n_sensors + 2) * blocks * VECTOR
    modes = given + N_FACTORS * VECTOR
    data = modes + N_ROWS * n_modes * VECTOR
    of_input = data + 2 * of_shapes
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
        of_input,
        of_input + of_sensors,
        mesh.lag_zero.ctypes.data,
        mesh.values.ctypes.data,
        mesh.even.ctypes.data,
        mesh.odd.ctypes.data,
        slopes[0].ctypes.data,
        slopes[1].ctypes.data,
        sums.squares.ctypes.data,
        sums.products.ctypes.data,
        mesh.step,
        n_modes,
        n_sensors,
        vectors,
        blocks,
        2 * blocks * vectors,
        sums.inputs[0, 0],
        sums.early[0, 0],
        sums.late[0, 0],
        sums.first[0],
        sums.last[0],
        sums.second[0],
        sums.kick[0],
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
