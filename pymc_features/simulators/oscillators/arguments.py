"""What every kernel takes besides the parameters of its structure: the excitation, and the outputs wanted."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit

# What `response` can return; the position is the code used inside the kernels.
QUANTITIES = (
    "absolute_acceleration",
    "relative_acceleration",
    "relative_velocity",
    "relative_displacement",
)
ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION, RELATIVE_VELOCITY, RELATIVE_DISPLACEMENT = range(4)


NO_DIRECT = np.empty((0, 0, 0))  # of inputs that are straight lines


class Excitation(NamedTuple):
    """An input that is linear between its samples, and the steps in which a structure is taken through it.

    A band-limited record comes prepared, see `simulators.excitation`: its states are right under the straight
    lines, and what stands before the inputs in a response takes their own values.

    Attributes
    ----------
    acceleration : array (t,) or (d, t)
        Ground acceleration [m/s^2], or d inputs: accelerations of supports [m/s^2] or forces [N].
    dt : float
        Sampling interval [s].
    substeps : int
        Steps of the recursion between two samples.
    stride : int
        Steps of the recursion between two outputs.
    direct : array (5, d, u) or (0, 0, 0)
        The inputs' own values and their first four derivatives at the outputs, which zeros may follow; empty
        where the straight lines are the inputs.
    """

    acceleration: np.ndarray
    dt: float
    substeps: int
    stride: int
    direct: np.ndarray = NO_DIRECT


class Outputs(NamedTuple):
    """What is asked of a structure.

    Attributes
    ----------
    sensors : integer array (s,), or array (s, n)
        Degrees of freedom, 0 next to the base; linear structures take a matrix of combinations of them.
    n_modes : int
        Modes kept, lowest first.
    quantity : int
        Position in `QUANTITIES`.
    """

    sensors: np.ndarray
    n_modes: int
    quantity: int


@jit
def n_outputs(n_times, substeps, stride):
    """Number of output samples of a record of `n_times` samples."""
    return ((n_times - 1) * substeps) // stride + 1


@jit
def ground_at(acceleration, fine, substeps):
    """Excitation after `fine` steps of the recursion, `substeps` to a sample; zero behind the record."""
    i = fine // substeps
    part = fine - i * substeps
    if i + 1 < acceleration.size:
        return acceleration[i] + part / substeps * (acceleration[i + 1] - acceleration[i])
    return acceleration[i] if i < acceleration.size and part == 0 else 0.0


@jit
def interpolate(acceleration, substeps, first, ground):
    """Write the excitation at the recursion's steps from `first` on; zero behind the record."""
    if substeps > 1:
        for k in range(ground.size):
            ground[k] = ground_at(acceleration, first + k, substeps)
        return
    for k in range(ground.size):  # Numba takes three seconds to compile a copy of a slice
        ground[k] = acceleration[first + k] if first + k < acceleration.size else 0.0


@jit
def write_own(excitation, ground, first, count, own):
    """Write the inputs' own values (d, >= count) at `count` outputs from `first` on; zero behind the last.

    `ground` (d, > count stride) are the inputs at the steps of the recursion from there on.
    """
    direct, stride = excitation.direct, excitation.stride
    for i in range(own.shape[0]):
        for b in range(count):
            if direct.size == 0:
                own[i, b] = ground[i, b * stride]
            else:
                own[i, b] = direct[0, i, first + b] if first + b < direct.shape[2] else 0.0


@jit
def excess_of(motion, length):
    """By how much the own values of one input (t,) are larger than the prepared ones, at the outputs.

    Zeros up to the length; empty where they are the same.
    """
    direct, acceleration = motion.direct, motion.acceleration
    excess = np.zeros(0 if direct.size == 0 else length)
    for k in range(min(excess.size, direct.shape[2])):
        excess[k] = direct[0, 0, k] - ground_at(acceleration, k * motion.stride, motion.substeps)
    return excess
