"""Memory of `population`: structures in the lanes of vector registers on their way through a record."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.oscillators.arguments import excess_of

SAMPLES = 16  # outputs handled at a time; a multiple of four
COLUMNS = 32  # outputs of modes that stay in the first-level cache, with their shapes, for a block of samples
N_COEFFICIENTS = 5  # of a mode
N_OF_PAIR = 6  # of a mode of which displacement and velocity are seen


class Lanes(NamedTuple):
    """Structures, one in each lane, with what they need on their way through a record.

    Modes are filled up to an even number, and there is room for one sensor more, of no consequence. Modes of
    which displacement and velocity are seen, `eigen.pairs`, have six coefficients and two outputs, each with
    its shapes.

    Attributes
    ----------
    coefficients, states : array (5 m, LANES), (2 m, LANES)
        Of the recursion.
    shapes, feed, direct : array ((s + 1) m, LANES), (s + 1, LANES), (s + 1, LANES)
        Output of each mode at the sensors, feed-through, and what of it is the input's own.
    outputs : array (COLUMNS SAMPLES, LANES)
        Of some modes in one block.
    misfits : array ((s + 1) SAMPLES, LANES)
        Of one block.
    ground, data : array (SAMPLES stride,), (s, SAMPLES)
        Excitation and data of one block.
    excess : array (>= u,)
        By how much the input's own values are larger than the prepared ones; empty where they are the same.
    has_gaps : bool
        Whether data are missing.
    squares : array (s + 1, LANES)
        Sums of squared misfits.
    """

    coefficients: np.ndarray
    states: np.ndarray
    shapes: np.ndarray
    feed: np.ndarray
    direct: np.ndarray
    outputs: np.ndarray
    misfits: np.ndarray
    ground: np.ndarray
    data: np.ndarray
    excess: np.ndarray
    has_gaps: bool
    squares: np.ndarray


class Increments(NamedTuple):
    """What the increments of the misfit need besides.

    Attributes
    ----------
    squares, first, last : array (s, LANES)
        Sums of squared increments, first and last misfits.
    """

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
def new_lanes(observed, n_modes, motion, is_pair):
    """Lanes without structures, for data (sensors, time) and a motion as of `at_every_step`.

    Of pairs, displacement and velocity are seen.
    """
    s, m = observed.shape[0], n_modes + n_modes % 2
    return Lanes(
        coefficients=new_vectors((N_OF_PAIR if is_pair else N_COEFFICIENTS) * m),
        states=new_vectors(2 * m),
        shapes=new_vectors((s + 1) * m * (2 if is_pair else 1)),
        feed=new_vectors(s + 1),
        direct=new_vectors(s + 1),
        outputs=new_vectors(COLUMNS * SAMPLES),
        misfits=new_vectors((s + 1) * SAMPLES),
        ground=np.empty(SAMPLES * motion.stride),
        data=np.empty((s, SAMPLES)),
        excess=excess_of(motion, -(-observed.shape[1] // SAMPLES) * SAMPLES),
        has_gaps=has_gaps(observed),
        squares=new_vectors(s + 1),
    )


@jit
def new_increments(n_sensors):
    """Room for the increments of the misfit."""
    return Increments(new_vectors(n_sensors), new_vectors(n_sensors), new_vectors(n_sensors))


@jit
def clear(lanes):
    """Take the structures out: zeros in lanes without one."""
    lanes.coefficients.fill(0.0)
    lanes.states.fill(0.0)
    lanes.shapes.fill(0.0)
    lanes.feed.fill(0.0)
    lanes.direct.fill(0.0)


@jit
def copy_data(lanes, observed, first):
    """Write a block of data, from sample `first` on, into `lanes.data`; zeros behind their end."""
    own_data = lanes.data
    for j in range(observed.shape[0]):
        for b in range(SAMPLES):
            own_data[j, b] = observed[j, first + b] if first + b < observed.shape[1] else 0.0
