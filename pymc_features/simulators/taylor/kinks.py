"""Kinks within a step: found on the polynomials of a spring, corrected for it and its neighbours.

All springs take a step on the branch that they have. Where drift rate or z of a spring has not the sign of
the branch at the end, or the drift rate dips through zero in between, the pair of spring and chain goes into
a batch of `LANES` such pairs, a record of its own. There the kink is found by Newton's method, both series
are shifted to it, z is expanded anew on the other branch with the drift rate as it was, and that once more if
another kink follows.

The change dz of z begins quadratically at the kink. With f = df/dz dz and its repeated integrals to the end,
J1 ... J4, the masses i and i - 1 have the changes of velocity and displacement

    dV_i = -H^2/m_i J1,    dU_i = -H^2/m_i J2,    dV_i-1 = H^2/m_i-1 J1,    dU_i-1 = H^2/m_i-1 J2,

and these change the forces of springs i - 1, i and i + 1 through their tangents, which gives J3 and J4, and
that of damping by modal ratios, which gives J2 and J3 once more. What is left is of the order of the sixth
power of the step.

Of some laws the series of z is not always good over a whole step (`ranges.py`). Such springs go into the
batch as well: their z is expanded anew at the beginning of the step, and wherever a series ceases to be good.

Roots and shifts of polynomials in memory, one in each lane.
"""

from functools import cache

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import larger, magnitude, where_less
from pymc_features.simulators.numbers.vector_math import exponential, logarithm
from pymc_features.simulators.numbers.vectors import (
    LANES,
    any_less,
    load,
    read_number,
    splat,
    store,
    write_number,
)
from pymc_features.simulators.taylor.layout import (
    CHANGE,
    N_ENTRIES,
    N_MOMENTS,
    RATE_SIGN,
    Z_END,
    Z_SIGN,
    layout_of,
)
from pymc_features.simulators.taylor.series import LONG, RATE, Spring, Z, constant_of, write_constant

MAX_ITERATIONS = 6
NEAR = 3e-3  # change of a root, in steps, after which it is right to the square of that
TINY = 1e-300


@cache
def polynomials_of(order):
    """Return the functions `shift`, `root` and `dip` for polynomials of an order."""

    @jit
    def value_and_slope(address, first, x):
        value, slope = load(address, first + order), splat(0.0)
        for k in range(order - 1, -1, -1):
            slope = slope * x + value
            value = value * x + load(address, first + k)
        return value, slope

    @jit
    def shift(address, one, other, x):
        """Move the origin of two polynomials to x."""
        for i in range(order):
            c, d = load(address, one + order), load(address, other + order)
            for j in range(order - 1, i - 1, -1):
                c = load(address, one + j) + x * c
                d = load(address, other + j) + x * d
                store(address, one + j, c)
                store(address, other + j, d)

    @jit
    def root(address, first, sign, at_end, end):
        """Root in (0, end) of sign times a polynomial that is positive at 0 and not at `end`: Newton.

        Where `sign` is zero nothing is looked for.
        """
        zero = splat(0.0)
        start, low, high = larger(sign * load(address, first), zero), zero, end
        x = end * start / (start - sign * at_end + TINY)
        x = where_less(zero, x, where_less(x, end, x, end), zero)
        leaves = sign * load(address, first + 1)  # the root at 0 is the kink before
        x = where_less(zero, leaves, larger(x, splat(0.5) * end), x)
        for _ in range(MAX_ITERATIONS):
            value, slope = value_and_slope(address, first, x)
            value, slope = value * sign, slope * sign
            low, high = where_less(zero, value, x, low), where_less(zero, value, high, x)
            better, middle = x - value / (slope - TINY), splat(0.5) * (low + high)
            better = where_less(better, low, middle, better)
            better = where_less(high, better, middle, better)
            change, x = magnitude((better - x) * sign), better
            if not any_less(splat(NEAR), change):
                break
        return x

    @jit
    def dip(address, first, sign):
        """Lowest place in (0, 1) of sign times a polynomial that first falls, and the polynomial there."""
        zero, one, x = splat(0.0), splat(1.0), splat(0.5)
        for _ in range(3):
            slope, bend = float(order) * load(address, first + order), zero
            for k in range(order - 1, 0, -1):
                bend = bend * x + slope
                slope = slope * x + float(k) * load(address, first + k)
            x = x - slope / (bend + sign * TINY)
            x = where_less(zero, x, where_less(x, one, x, one), zero)
        return x, value_and_slope(address, first, x)[0]

    return shift, root, dip


MAX_KINKS = 4  # of one spring in one step
MAX_PIECES = 24  # and where a series is put together of several
LARGEST_TERM = 1e-6  # of the last power of z in a piece: there it ends
# Entries of a batch behind its record: drift rate at the end, address and record of each pair, and its lane
RATE_END, OWNER, PLACE, LANE = range(4)
N_BATCH_ENTRIES = 4
# Entries of a trace behind each copy of a batch: where the kink is, from the kink before, and what is left
# of the step behind it; 1 in lanes whose z is expanded anew there, where that is at a kink, and where the
# drift rate is zero there; the signs behind it; whether it is the first of the batch, and the number of pairs
WHERE, LEFT, HIT, KINK, TURNS, RATE_SIGN_BEHIND, Z_SIGN_BEHIND, IS_FIRST, N_PAIRS = range(9)
N_TRACE_ENTRIES = 9
TRACE_HEADER = 1  # the number of copies


def batch_size(series) -> int:
    """Vectors of a batch: a record, the old coefficients of z, the entries and a vector of drift rates."""
    length, record, _, _ = layout_of(series)
    return record + length + N_BATCH_ENTRIES + 1


def trace_size(series, n: int) -> int:
    """Vectors of the trace of a step of n springs; n = 0: of one kink of the pairs in a batch."""
    size = batch_size(series) + N_TRACE_ENTRIES
    most = MAX_KINKS if series.pieces is None else MAX_PIECES + 1
    return size if n == 0 else TRACE_HEADER + (n + 1) * most * size


@cache
def expansion_of(series, k):
    """Return a function that expands z of a spring anew, from order k on, with the drift rates it has."""
    expand, is_last = jit(series.expand), k == series.order - 1
    rest = None if is_last else expansion_of(series, k + 1)

    @jit
    def last(spring):
        rate = load(spring.address, spring.first + RATE * spring.length + k)
        expand(spring, k, splat(0.0), rate)

    if is_last:
        return last

    @jit
    def expansion(spring):
        rate = load(spring.address, spring.first + RATE * spring.length + k)
        expand(spring, k, splat(0.0), rate)
        rest(spring)

    return expansion


@cache
def turn_of(series):
    """Return the function that corrects all kinks of the pairs in a batch."""
    length, record, entries, constants = layout_of(series)
    order, branch, tangent = series.order, jit(series.branch), jit(series.tangent)
    size, turn_size = batch_size(series), trace_size(series, 0)
    shift, root, dip = polynomials_of(order)
    expand_again = expansion_of(series, 0)
    rates, zs, old, more = length * (1 + RATE), length * (1 + Z), record, record + length
    pieces = series.pieces
    most = MAX_KINKS if pieces is None else MAX_PIECES

    @jit
    def until(batch, spring, left):
        """Until when the series of z is good: where its last term becomes too large at the latest."""
        ends, last = constant_of(spring, pieces.hold), magnitude(load(batch, zs + order))
        for _ in range(order):
            last = last * left
        if any_less(splat(LARGEST_TERM), last):
            good = left * exponential(logarithm(splat(LARGEST_TERM) / last) * (1.0 / order))
            good = where_less(splat(LARGEST_TERM), last, good, ends)
            ends = where_less(good, ends, good, ends)
        return ends

    @jit
    def add_moments(batch, hit, left):
        """Add the change of z to its moments, from the difference of the new series and the old."""
        e0 = e1 = e2 = e3 = e4 = splat(0.0)
        for k in range(order, 0, -1):
            before = load(batch, old + k)
            after = where_less(splat(0.0), hit, load(batch, zs + k), before)
            store(batch, zs + k, after)
            c = after - before
            i1 = 1.0 / (k + 1)
            i2 = i1 / (k + 2)
            i3 = i2 / (k + 3)
            e0 = e0 * left + c
            e1 = e1 * left + c * i1
            e2 = e2 * left + c * i2
            e3 = e3 * left + c * i3
            e4 = e4 * left + c * (i3 / (k + 4))
        at = entries + CHANGE
        power = left
        for change in (e0, e1, e2, e3, e4):
            store(batch, at, load(batch, at) + change * power)
            power = power * left
            at += 1

    @jit
    def renew(batch, spring, left):
        """Expand z anew, and keep the coefficients it had."""
        for k in range(length):
            store(batch, old + k, load(batch, zs + k))
        if pieces is not None:
            write_constant(spring, pieces.left, left)
        expand_again(spring)

    @jit
    def value_at(batch, x):
        """z at a time."""
        z = load(batch, zs + order)
        for k in range(order - 1, -1, -1):
            z = z * x + load(batch, zs + k)
        return z

    @jit
    def keep_turn(batch, trace, given):
        """Add a copy of the batch, with some vectors more, to the trace (`adjoint/kinks.py`)."""
        number = int(read_number(trace, 0))
        at = TRACE_HEADER + number * turn_size
        for i in range(length, more + N_BATCH_ENTRIES):
            store(trace, at + i, load(batch, i))
        for i in range(len(given)):
            store(trace, at + size + i, given[i])
        write_number(trace, 0, number + 1.0)

    @jit
    def turn(batch, count, trace):
        """Correct the first `count` pairs; what a spring has beyond `MAX_KINKS` is left to the next step.

        Unless `trace` is None, what a gradient needs of each kink is added to it.
        """
        zero, one = splat(0.0), splat(1.0)
        for c in range(CHANGE, CHANGE + 1 + N_MOMENTS):
            store(batch, entries + c, zero)
        z_end, rate_end = load(batch, entries + Z_END), load(batch, more + RATE_END)
        rate_sign, z_sign = load(batch, entries + RATE_SIGN), load(batch, entries + Z_SIGN)
        spring = Spring(batch, length, length, constants)
        done, reach, low, z_now, reach_z, ends = zero, one, rate_end, z_end, one, splat(LONG)
        back = where_less(rate_end * rate_sign, zero, one, zero)
        cross = where_less(z_end * z_sign, zero, one, zero)
        start = load(batch, rates) + load(batch, rates + 1)
        dips = where_less(start * rate_sign, zero, one, zero) * (one - back)
        if any_less(zero, dips):
            where, value = dip(batch, rates, rate_sign)
            dips = dips * where_less(value * rate_sign, zero, one, zero)
            reach = where_less(zero, dips, where, one)
            low = where_less(zero, dips, value, low)
            back = back + dips
        hit, is_first = where_less(zero, back + cross, one, zero), one
        if pieces is not None:
            write_constant(spring, pieces.whole, zero)
            again = where_less(constant_of(spring, pieces.hold), one, one, zero)
            if any_less(zero, again):
                renew(batch, spring, one)
                if trace is not None:
                    pairs = splat(float(count))
                    given = zero, one, again, zero, zero, rate_sign, z_sign, one, pairs
                    keep_turn(batch, trace, given)
                add_moments(batch, again, one)
                ends = where_less(zero, again, until(batch, spring, one), ends)
                reach_z = where_less(ends, one, ends, one)
                z_now = value_at(batch, reach_z)
                cross = where_less(z_now * z_sign, zero, one, zero)
                hit = where_less(zero, back + cross + where_less(ends, one, one, zero), one, zero)
                is_first = zero
        for _ in range(most):
            if not any_less(zero, hit):
                break
            left = one - done
            x, turns = left, zero
            if any_less(zero, back):
                end = where_less(zero, dips, reach - done, left)
                r = root(batch, rates, rate_sign * back, low, end)
                x = where_less(zero, back, where_less(r, x, r, x), x)
                turns = back
            if any_less(zero, cross):
                r = root(batch, zs, z_sign * cross, z_now, reach_z)
                first = cross * where_less(r, x, one, zero)
                x = where_less(zero, first, r, x)
                turns = turns * (one - first)
            kink = hit
            if pieces is not None:
                kink = where_less(ends, x, zero, hit)
                x = where_less(ends, x, ends, x)
            x = where_less(zero, hit, x, zero)
            shift(batch, rates, zs, x)
            done = done + x
            left = one - done
            rate_sign = where_less(zero, kink * turns, zero - rate_sign, rate_sign)
            z_sign = where_less(zero, kink * (one - turns), zero - z_sign, z_sign)
            branch(spring, rate_sign * z_sign, z_sign)
            renew(batch, spring, left)
            if trace is not None:
                pairs = splat(float(count))
                given = x, left, hit, kink, turns, rate_sign, z_sign, is_first, pairs
                keep_turn(batch, trace, given)
                is_first = zero
            add_moments(batch, hit, left)
            z_now, reach_z = z_end + load(batch, entries + CHANGE), left
            short, still = zero, zero
            if pieces is not None:
                ends = until(batch, spring, left)
                reach_z = where_less(ends, left, ends, left)
                z_now = value_at(batch, reach_z)
                short = hit * where_less(ends, left, one, zero)
                still = hit - kink  # a piece may end before the dip
            dips = dips * still
            low = where_less(zero, dips, low, rate_end)
            back = hit * where_less(low * rate_sign, zero, one, zero)
            cross = hit * where_less(z_now * z_sign, zero, one, zero)
            hit = where_less(zero, back + cross + short, one, zero)
        store(batch, entries + RATE_SIGN, rate_sign)
        store(batch, entries + Z_SIGN, z_sign)
        by_z = tangent(spring, z_end)[2]
        for c in range(CHANGE + 1, CHANGE + 1 + N_MOMENTS):
            store(batch, entries + c, by_z * load(batch, entries + c))
        hand_back(batch, count)

    @jit
    def hand_back(batch, count):
        """Copy what the kinks change to the springs and lanes that it belongs to."""
        for lane in range(count):
            address = int(read_number(batch, (more + OWNER) * LANES + lane))
            place = int(read_number(batch, (more + PLACE) * LANES + lane))
            own = int(read_number(batch, (more + LANE) * LANES + lane))
            for c in range(CHANGE, N_ENTRIES):
                value = read_number(batch, (entries + c) * LANES + lane)
                write_number(address, (place + entries + c) * LANES + own, value)

    return turn
