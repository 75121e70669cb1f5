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


class Excitation(NamedTuple):
    """An input that is linear between its samples, and the steps in which a structure is taken through it.

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
    """

    acceleration: np.ndarray
    dt: float
    substeps: int
    stride: int


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
def single_input(excitation):
    """The excitation with its only input as (t,)."""
    acceleration, dt, substeps, stride = excitation
    return Excitation(acceleration.reshape(acceleration.size), dt, substeps, stride)


@jit
def at_every_step(excitation):
    """The excitation by one input with a sample at each step of the recursion, as (t,)."""
    acceleration, dt, substeps, stride = single_input(excitation)
    every = np.empty((acceleration.size - 1) * substeps + 1)
    interpolate(acceleration, substeps, 0, every)
    return Excitation(every, dt / substeps, 1, stride)


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
