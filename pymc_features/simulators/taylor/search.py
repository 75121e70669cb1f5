"""Which springs of a group have kinks in a step: they go into batches, see `kinks.py`."""

from functools import cache

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, magnitude, splat, where_less
from pymc_features.simulators.compiled.vector_memory import (
    any_less,
    first_lane,
    lanes_less,
    read_lanes,
    read_number,
    write_lanes,
    write_number,
)
from pymc_features.simulators.taylor.kinks import LANE, N_BATCH_ENTRIES, OWNER, PLACE, RATE_END, turn_of
from pymc_features.simulators.taylor.layout import (
    CHANGE,
    HAS_KINK,
    N_MOMENTS,
    RATE_SIGN,
    V_END,
    Z_END,
    Z_SIGN,
    layout_of,
)
from pymc_features.simulators.taylor.series import RATE, Spring, Z, constant_of, write_constant


@cache
def search_of(series):
    """Return the function that finds the springs with kinks in a group, and fills batches with them."""
    length, record, entries, constants = layout_of(series)
    turn, pieces = turn_of(series), series.pieces
    rates, more, flags = length * (1 + RATE), record + length, record + length + N_BATCH_ENTRIES

    @jit
    def put(batch, c, count, number):
        if count == 0:
            write_lanes(batch, c, splat(number))
        else:
            write_number(batch, c * LANES + count, number)

    @jit
    def pack(address, here, lane, batch, count):
        """Copy a spring of one chain into lane `count` of the batch; the first one goes into all lanes."""
        for c in range(length, length * (2 + Z)):
            put(batch, c, count, read_number(address, (here + c) * LANES + lane))
        for c in range(entries + Z_END, record):
            put(batch, c, count, read_number(address, (here + c) * LANES + lane))
        put(batch, more + RATE_END, count, read_number(batch, flags * LANES + lane))
        put(batch, more + OWNER, count, float(address))
        put(batch, more + PLACE, count, float(here))
        put(batch, more + LANE, count, float(lane))

    @jit
    def search(address, high, size, batch, count, trace):
        """Return the number of pairs that wait in the batch; springs with kinks have zero changes."""
        zero = splat(0.0)
        for i in range(high - size + 1, high + 1):
            here = i * record
            at = here + entries
            rate_sign, z_sign = read_lanes(address, at + RATE_SIGN), read_lanes(address, at + Z_SIGN)
            rate_end = read_lanes(address, at + V_END) - read_lanes(address, at + V_END - record)
            a, b = rate_end * rate_sign, read_lanes(address, at + Z_END) * z_sign
            lowest = where_less(a, b, a, b)
            start = read_lanes(address, here + rates) + read_lanes(address, here + rates + 1)
            start = start * rate_sign
            lowest = where_less(start, lowest, start, lowest)
            if pieces is not None:
                spring = Spring(address, here + length, length, here + constants)
                away = constant_of(spring, pieces.sign) * read_lanes(address, at + Z_END)
                away = magnitude(away - constant_of(spring, pieces.middle))
                hold = constant_of(spring, pieces.hold)
                hold = where_less(constant_of(spring, pieces.half), away, zero, hold)
                write_constant(spring, pieces.hold, hold)
                lowest = where_less(hold, splat(1.0), splat(-1.0), lowest)
            has_kink = any_less(lowest, zero)
            write_number(address, (at + HAS_KINK) * LANES, 1.0 if has_kink else 0.0)
            if has_kink:
                for c in range(CHANGE, CHANGE + 1 + N_MOMENTS):
                    write_lanes(address, at + c, zero)
                write_lanes(batch, flags, rate_end)
                lanes = lanes_less(lowest, zero)
                while lanes != 0:
                    pack(address, here, first_lane(lanes), batch, count)
                    lanes &= lanes - 1
                    count += 1
                    if count == LANES:
                        turn(batch, count, trace)
                        count = 0
        return count

    return search
