"""Records of accepted steps, through which a gradient goes back (`step_adjoint.py`).

A tape has room for `CAPACITY` steps. It keeps those from a given number on; where a march takes more of them,
it is repeated for the others.

    header   numbers `COUNT` and `FIRST`, in one vector
    step     the block `BRANCH` and the three blocks of the state at its start, then one vector with the
             numbers `STEP` [s], `GROUND` [m/s^2], `TREND` [m/s^3] and `KINK` (-1 where it ends at none)
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import (
    aligned,
    read_lanes,
    read_number,
    write_lanes,
    write_number,
)
from pymc_features.simulators.nonlinear.layout import BRANCH, padded

CAPACITY = 256
COUNT, FIRST = range(2)  # steps so far, number of the first one kept
STEP, GROUND, TREND, KINK = range(4)


class Tape(NamedTuple):
    """Where a tape lies, and how many vectors one record has."""

    address: int
    size: int


def tape_memory(n: int) -> np.ndarray:
    """Memory of a tape for n degrees of freedom."""
    return aligned(LANES * (1 + CAPACITY * record_size(n)))


def record_size(n: int) -> int:
    """Vectors in one record for n degrees of freedom."""
    return 4 * padded(n) // LANES + 1


@jit
def rewind(tape, first):
    """Begin a march whose steps are kept from number `first` on."""
    write_number(tape.address, COUNT, 0.0)
    write_number(tape.address, FIRST, float(first))


@jit
def recorded(tape):
    """Number of steps of the march, and of those kept."""
    count, first = int(read_number(tape.address, COUNT)), int(read_number(tape.address, FIRST))
    return count, min(count - first, CAPACITY)


@jit
def write_tape(law, tape, step, ground, trend, which):
    """Record an accepted step, which begins at the present state and ends at kink `which`, or at none: -1."""
    count = read_number(tape.address, COUNT)
    index = int(count - read_number(tape.address, FIRST))
    write_number(tape.address, COUNT, count + 1.0)
    if 0 <= index < CAPACITY:
        first = 1 + index * tape.size
        for row in range(4 * law.rows):
            write_lanes(tape.address, first + row, read_lanes(law.address, BRANCH * law.rows + row))
        last = (first + 4 * law.rows) * LANES
        write_number(tape.address, last + STEP, step)
        write_number(tape.address, last + GROUND, ground)
        write_number(tape.address, last + TREND, trend)
        write_number(tape.address, last + KINK, float(which))


@jit
def read_tape(law, tape, index):
    """Restore branches and state at the start of kept step `index`; return step, ground, trend and kink."""
    first = 1 + index * tape.size
    for row in range(4 * law.rows):
        write_lanes(law.address, BRANCH * law.rows + row, read_lanes(tape.address, first + row))
    last = (first + 4 * law.rows) * LANES
    return (
        read_number(tape.address, last + STEP),
        read_number(tape.address, last + GROUND),
        read_number(tape.address, last + TREND),
        int(read_number(tape.address, last + KINK)),
    )
