"""Layout in memory of the chains of a group, one in each lane.

Every spring, with the mass above it, has a record of vectors: the coefficients of the mass's velocity H v,
the series of the spring (`series.py`), the entries below, and the constants of the law. Record 0 is the base,
all zeros; springs are numbered from 1. Behind the last record stand entries of whole chains, what a block of
springs leaves to the one below it (`blocks.py`), and the load: H^2 times the coefficients of the ground
acceleration. H is the step.

Where a group of chains was at the beginning of each step: its gradient goes back from there.

A tape has room for `capacity` steps. Where a march takes more of them the tape is begun anew, as often as
needed; the state at the beginning of every such segment is kept as well, so that the gradient can march
through it once more. Kept are also the number of steps to each span of the record (`ground/spans.py`), and
the misfits of the sensors.
"""

from contextlib import suppress
from functools import cache
from typing import NamedTuple

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import where_less
from pymc_features.simulators.numbers.vectors import (
    LANES,
    aligned,
    load,
    read_number,
    splat,
    store,
    stream,
    write_number,
)
from pymc_features.simulators.taylor.ground import DEGREE

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
    """First vector of the load of a chain, behind its last record."""
    return N_CHAIN_ENTRIES + N_LEFT * series.order


def group_size(series, n: int) -> int:
    """Vectors of a group of chains with n springs."""
    return (n + 1) * layout_of(series).record + load_of(series) + N_LOADS


@jit
def add_lanes(address, index, value):
    """Add to a vector."""
    store(address, index, load(address, index) + value)


MAX_STEPS = 64  # of a span
ROOM = 1 << 28  # bytes of the steps of a tape: some 1,500 samples of 100 masses
KEPT_ROOM = 1 << 26  # bytes of the steps that are kept for the next gradient
# Numbers: segments so far, steps of the last one, steps to a span at the end; then those to each span, then
# the first span of each segment
SEGMENTS, STEPS, COUNT, COUNTS = range(4)


class Tape(NamedTuple):
    """Addresses of what is kept; a tape without capacity keeps nothing.

    Attributes
    ----------
    states, starts : addresses of vectors
        States at the beginnings of steps, and of segments.
    misfits : address of vectors (time, sensor)
    numbers : address
        As listed above.
    capacity, n_spans : int
        Steps and spans that there is room for.
    """

    states: int
    starts: int
    misfits: int
    numbers: int
    capacity: int
    n_spans: int


NO_TAPE = Tape(0, 0, 0, 0, 0, 0)
_KEPT: list = []  # the memory of the last gradient


class TapeMemory:
    """Memory of a tape for a group of chains, `size` vectors in each state.

    Pages that are never written cost nothing, new ones more than what is written there.
    """

    def __init__(self, size, capacity, n_spans, n_sensors, n_samples):
        self.sizes, self.state_bytes = (size, capacity, n_spans, n_sensors, n_samples), 8 * LANES * size
        segments = n_spans * MAX_STEPS // (capacity - MAX_STEPS) + 1
        self.states = aligned(capacity * size * LANES)
        self.starts = aligned(segments * size * LANES)
        self.misfits = aligned(n_samples * n_sensors * LANES)
        self.numbers = aligned(COUNTS + n_spans + segments)
        memories = self.states, self.starts, self.misfits, self.numbers
        self.tape = Tape(*(m.ctypes.data for m in memories), capacity, n_spans)

    def clear(self):
        """Begin a march."""
        self.numbers[:COUNTS] = 0.0

    def keep(self):
        """Let the next gradient have it, unless it is large."""
        if self.numbers[STEPS] * self.state_bytes <= KEPT_ROOM:
            _KEPT[:] = [self]


def tape_memory(series, n, n_spans, n_sensors, n_samples) -> TapeMemory:
    """Return memory for chains with n springs: that of the last gradient, if it was of the same kind."""
    size = width_of(series) * n
    capacity = max(min(n_spans * MAX_STEPS, ROOM // (8 * LANES * size)), 2 * MAX_STEPS)
    sizes = size, capacity, n_spans, n_sensors, n_samples
    with suppress(IndexError):
        known = _KEPT.pop()  # no other thread takes it as well
        if known.sizes == sizes:
            return known
    return TapeMemory(*sizes)


def width_of(series) -> int:
    """Vectors that are kept of each spring: H v and u, and with kinks z and the signs."""
    return 2 if series.branch is None else 4


@jit
def signs_of(signs):
    """Signs of drift rate and z, from what is kept of them."""
    rate_sign = where_less(signs, splat(0.0), splat(-1.0), splat(1.0))
    return rate_sign, signs - 2.0 * rate_sign


@cache
def tape_of(series):
    """Return the functions that keep a state, bring one back, and note the steps that were accepted."""
    _, record, entries, _ = layout_of(series)
    width, kinks = width_of(series), series.branch is not None

    @jit
    def keep(group, states, slot):
        """Write the state of all springs to slot number `slot`."""
        address, n = group.address, group.n
        to = slot * n * width
        for i in range(1, n + 1):
            at = i * record + entries
            stream(states, to, load(address, at + V_END))
            stream(states, to + 1, load(address, at + U))
            if kinks:
                signs = 2.0 * load(address, at + RATE_SIGN) + load(address, at + Z_SIGN)
                stream(states, to + 2, load(address, at + Z_END))
                stream(states, to + 3, signs)
            to += width

    @jit
    def restore(group, state, high, size):
        """Make a kept state that of a block of springs."""
        address = group.address
        for i in range(high - size + 1, high + 1):
            to = (i - 1) * width
            at = i * record + entries
            store(address, at + V_END, load(state, to))
            store(address, at + U, load(state, to + 1))
            if kinks:
                rate_sign, z_sign = signs_of(load(state, to + 3))
                store(address, at + Z_END, load(state, to + 2))
                store(address, at + RATE_SIGN, rate_sign)
                store(address, at + Z_SIGN, z_sign)

    @jit
    def accept(group, tape, span, count):
        """Note that `count` steps, behind those on the tape, led through a span."""
        steps, segments = int(read_number(tape.numbers, STEPS)), int(read_number(tape.numbers, SEGMENTS))
        write_number(tape.numbers, COUNTS + span, float(count))
        if steps == 0:
            size = group.n * width
            for i in range(size):
                store(tape.starts, segments * size + i, load(tape.states, i))
            write_number(tape.numbers, COUNTS + tape.n_spans + segments, float(span))
            write_number(tape.numbers, SEGMENTS, segments + 1.0)
        write_number(tape.numbers, STEPS, float(steps + count))

    @jit
    def first_free(tape):
        """The slot of the next step, where as many as there may be have room."""
        steps = int(read_number(tape.numbers, STEPS))
        if steps + MAX_STEPS > tape.capacity:
            write_number(tape.numbers, STEPS, 0.0)
            return 0
        return steps

    return keep, restore, accept, first_free
