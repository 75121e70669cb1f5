"""Memory of a vector of structures on their way through a record, with what their gradient takes from it.

Compiled code reaches it by addresses: an array among the arguments of each small function would cost two
atomic operations of reference counting, more than the work in it.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import read_number, write_number
from pymc_features.simulators.oscillators.lanes import SAMPLES

N_FILTER, N_STATES = 20, 6  # coefficients and states of a mode, see `filters`
VECTOR = 8 * LANES  # bytes


class GradientLanes(NamedTuple):
    """Structures, one in each lane, and what their gradient takes from the history.

    Sensors s and modes m are filled up to even numbers. All but the first five are addresses: of vectors, or
    of numbers in the last four. Entry (j, r) of what has s m vectors is number j m + r.

    Attributes
    ----------
    n_sensors, n_modes, stride, s, m : int
    omega, damping, slopes, ratios, participation : (m)
        [rad/s], D [1/s], dD/dlambda [s] along the law of damping, damping ratios added to Rayleigh's, Gamma.
    factors : (s)
        Derivatives of L by e_j, times 2 / N_D.
    coefficients, states, sums, before : (20 m), (6 m), (6 m), (2 m)
        Of `filters`; sums of u times the states; W and E at the beginning of the block.
    shapes, scaled, products, by_shapes : (s m)
        S Phi; S Phi Gamma; sums of dL/dy_j times modal outputs; dL/d(S Phi) outside of the span of Phi.
    direct, of_ground : (s)
        Feed-through; sums of dL/dy_j times the ground acceleration.
    outputs, weighted, turned : (m SAMPLES stride), (s SAMPLES), (m SAMPLES)
        One block: modal outputs at all steps, dL/dy, u.
    by_lambda, by_damping, by_load : (m)
        dL/dlambda at fixed shapes, dL/dD, dL/d(Phi' L).
    by_stiffness, by_mass : (m m)
        dL/d(Phi' K Phi) and dL/d(Phi' M Phi), symmetric.
    data, measured, ground : (s SAMPLES), (s SAMPLES), (SAMPLES stride + 1) numbers
        One block: data, one where there are data and zero elsewhere, excitation.
    feed : (s) numbers
        What stands before the input in outputs, beside modal ones that are relative to it.
    """

    n_sensors: int
    n_modes: int
    stride: int
    s: int
    m: int
    omega: int
    damping: int
    slopes: int
    ratios: int
    participation: int
    factors: int
    coefficients: int
    states: int
    sums: int
    before: int
    shapes: int
    scaled: int
    products: int
    by_shapes: int
    direct: int
    of_ground: int
    outputs: int
    weighted: int
    turned: int
    by_lambda: int
    by_damping: int
    by_load: int
    by_stiffness: int
    by_mass: int
    data: int
    measured: int
    ground: int
    feed: int


@jit
def first_vector(room):
    """Address of the first whole vector in a memory, which the caller keeps."""
    return (room.ctypes.data + VECTOR - 1) // VECTOR * VECTOR


@jit
def room_of_lanes(n_sensors, n_modes, stride):
    """Memory for `new_gradient_lanes`, zeros."""
    s, m = n_sensors + n_sensors % 2, n_modes + n_modes % 2
    vectors = (42 + 4 * s + 2 * m + SAMPLES * (stride + 1)) * m + (3 + SAMPLES) * s
    return np.zeros((vectors + 1) * LANES + SAMPLES * stride + 1 + (2 * SAMPLES + 1) * s)


@jit
def new_gradient_lanes(room, feed, n_modes, stride):
    """Lanes without structures, `feed` (s,), in a memory from `room_of_lanes`, which the caller keeps."""
    n_sensors = feed.size
    s, m = n_sensors + n_sensors % 2, n_modes + n_modes % 2
    of_modes, of_sensors, of_shapes = VECTOR * m, VECTOR * s, VECTOR * s * m
    omega = first_vector(room)
    factors = omega + 5 * of_modes
    coefficients = factors + of_sensors
    states = coefficients + N_FILTER * of_modes
    shapes = states + (2 * N_STATES + 2) * of_modes
    direct = shapes + 4 * of_shapes
    outputs = direct + 2 * of_sensors
    weighted = outputs + SAMPLES * stride * of_modes
    turned = weighted + SAMPLES * of_sensors
    by_lambda = turned + SAMPLES * of_modes
    by_stiffness = by_lambda + 3 * of_modes
    data = by_stiffness + 2 * m * of_modes
    measured = data + 8 * SAMPLES * s
    ground = measured + 8 * SAMPLES * s
    own_feed = ground + 8 * (SAMPLES * stride + 1)
    for j in range(n_sensors):
        write_number(own_feed, j, feed[j])
    return GradientLanes(
        n_sensors,
        n_modes,
        stride,
        s,
        m,
        omega,
        omega + of_modes,
        omega + 2 * of_modes,
        omega + 3 * of_modes,
        omega + 4 * of_modes,
        factors,
        coefficients,
        states,
        states + N_STATES * of_modes,
        states + 2 * N_STATES * of_modes,
        shapes,
        shapes + of_shapes,
        shapes + 2 * of_shapes,
        shapes + 3 * of_shapes,
        direct,
        direct + of_sensors,
        outputs,
        weighted,
        turned,
        by_lambda,
        by_lambda + of_modes,
        by_lambda + 2 * of_modes,
        by_stiffness,
        by_stiffness + m * of_modes,
        data,
        measured,
        ground,
        own_feed,
    )


@jit
def ground_of(lanes, room):
    """The block of the excitation, an array (SAMPLES stride + 1,)."""
    first = (lanes.ground - room.ctypes.data) // 8
    return room[first : first + SAMPLES * lanes.stride + 1]


@jit
def put(block, row, lane, number):
    """Write one number into a vector of a block."""
    write_number(block, row * LANES + lane, number)


@jit
def get(block, row, lane):
    """One number of a vector of a block."""
    return read_number(block, row * LANES + lane)


@jit
def clear(lanes, lane):
    """Take the structure out of a lane."""
    for block in (lanes.omega, lanes.damping, lanes.slopes, lanes.ratios, lanes.participation):
        for r in range(lanes.m):
            put(block, r, lane, 0.0)
    for j in range(lanes.s):
        put(lanes.factors, j, lane, 0.0)
        for r in range(lanes.m):
            put(lanes.shapes, j * lanes.m + r, lane, 0.0)
