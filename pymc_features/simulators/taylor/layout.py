"""Where the chains of a group, one in each lane, lie in memory.

Every spring, with the mass above it, has a record of vectors: the coefficients of the mass's velocity H v,
the series of the spring (`series.py`), the entries below, and the constants of the law. Record 0 is the base,
all zeros; springs are numbered from 1. Behind the last record stand entries of whole chains, what a block of
springs leaves to the one below it (`blocks.py`), and the load: H^2 times the coefficients of the ground
acceleration. H is the step.
"""

from typing import NamedTuple

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector_memory import read_lanes, write_lanes
from pymc_features.simulators.taylor.ground.projection import DEGREE

# Entries of a record: displacement [m], H^2 / m [s^2/kg], beta k / H [N/m]; H v [m] where a step ends and the
# next begins; and with kinks: whether a lane has one; their change of z, and of the force integrated 1 ... 4
# times over the step; z at its end; the signs of drift rate and z
U, MOBILITY, DASHPOT, V_END, HAS_KINK, CHANGE = range(6)
N_MOMENTS = 4
Z_END, RATE_SIGN, Z_SIGN = range(CHANGE + 1 + N_MOMENTS, CHANGE + 1 + N_MOMENTS + 3)
N_ENTRIES = Z_SIGN + 1
# Entries of a chain: alpha H, largest acceleration so far [m/s^2], the largest first and last coefficients of
# H v and last ones of z since they were looked at, the largest error by kinks (`feedback.py`), and 1 where
# the chain is given up
DRAG, PEAK, FIRST, LAST, LAST_Z, KINK_ERROR, LOST = range(7)
N_CHAIN_ENTRIES = 8  # one is not used: gradients of ten masses were measured to take 7 % longer with seven
N_LEFT = 2  # vectors for each order that a block leaves
# Behind the coefficients of the load: what of the last one, in one of a velocity, is no error; and a
# number above zero where the load is not linear
HARMLESS, CURVED = range(DEGREE + 1, DEGREE + 3)
N_LOADS = DEGREE + 3


class Layout(NamedTuple):
    """Sizes in vectors: of a series, and of a record; and where a record's entries and constants begin."""

    length: int
    record: int
    entries: int
    constants: int


def layout_of(series) -> Layout:
    """Layout of the chains of a recurrence."""
    length = series.order + 1
    entries = (1 + series.n_series) * length
    constants = entries + N_ENTRIES
    return Layout(length, constants + series.n_constants, entries, constants)


def load_of(series) -> int:
    """Where the load of a chain begins, behind its last record."""
    return N_CHAIN_ENTRIES + N_LEFT * series.order


def group_size(series, n: int) -> int:
    """Vectors of a group of chains with n springs."""
    return (n + 1) * layout_of(series).record + load_of(series) + N_LOADS


@jit
def add_lanes(address, index, value):
    """Add to a vector."""
    write_lanes(address, index, read_lanes(address, index) + value)
