"""Memory of `population`: structures in the lanes of vector registers on their way through a record."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES

SAMPLES = 16  # outputs handled at a time; a multiple of four
N_COEFFICIENTS = 5  # of a mode
N_OF_PAIR = 6  # of a mode of which displacement and velocity are seen


class Lanes(NamedTuple):
    """Structures, one in each lane, with what they need on their way through a record.

    Sensors and modes are filled up to even numbers. Modes of which displacement and velocity are seen,
    `eigen.pairs`, have six coefficients and two outputs, each with its shapes.

    Attributes
    ----------
    coefficients, states : array (5 m, LANES), (2 m, LANES)
        Of the recursion.
    shapes, feed : array (s m, LANES), (s, LANES)
        Output of each mode at the sensors, and feed-through.
    outputs, ground, data : array (m SAMPLES, LANES), (SAMPLES stride,), (sensors, SAMPLES)
        One block: modal outputs, excitation, data.
    has_gaps : bool
        Whether data are missing.
    squares : array (s, LANES)
        Sums of squared misfits.
    """

    coefficients: np.ndarray
    states: np.ndarray
    shapes: np.ndarray
    feed: np.ndarray
    outputs: np.ndarray
    ground: np.ndarray
    data: np.ndarray
    has_gaps: bool
    squares: np.ndarray


class Increments(NamedTuple):
    """What the increments of the misfit need besides.

    Attributes
    ----------
    misfits : array (s SAMPLES, LANES)
        Of one block.
    squares, first, last : array (s, LANES)
        Sums of squared increments, first and last misfits.
    """

    misfits: np.ndarray
    squares: np.ndarray
    first: np.ndarray
    last: np.ndarray


@jit
def has_gaps(observed):
    """Whether there are NaN in data (sensors, time)."""
    for j in range(observed.shape[0]):
        for k in range(observed.shape[1]):
            if observed[j, k] != observed[j, k]:
                return True
    return False


@jit
def new_lanes(observed, n_modes, stride):
    """Lanes without structures, for data (sensors, time)."""
    n_sensors = observed.shape[0]
    s, m = n_sensors + n_sensors % 2, n_modes + n_modes % 2
    return Lanes(
        coefficients=np.zeros((N_COEFFICIENTS * m, LANES)),
        states=np.zeros((2 * m, LANES)),
        shapes=np.zeros((s * m, LANES)),
        feed=np.zeros((s, LANES)),
        outputs=np.empty((SAMPLES * m, LANES)),
        ground=np.empty(SAMPLES * stride),
        data=np.empty((n_sensors, SAMPLES)),
        has_gaps=has_gaps(observed),
        squares=np.empty((s, LANES)),
    )


@jit
def new_increments(n_sensors):
    """Room for the increments of the misfit."""
    s = n_sensors + n_sensors % 2
    squares, first, last = np.empty((s, LANES)), np.empty((s, LANES)), np.empty((s, LANES))
    return Increments(np.empty((s * SAMPLES, LANES)), squares, first, last)


@jit
def clear(lanes):
    """Take the structures out: zeros in lanes without one."""
    lanes.coefficients.fill(0.0)
    lanes.states.fill(0.0)
    lanes.shapes.fill(0.0)
    lanes.feed.fill(0.0)


@jit
def copy_data(lanes, observed, first, count):
    """Write a block of data, from sample `first` on, into `lanes.data`; zeros behind `count` samples."""
    own_data = lanes.data
    for j in range(observed.shape[0]):
        for b in range(SAMPLES):
            own_data[j, b] = observed[j, first + b] if b < count else 0.0
