"""The kinks of a step in reverse: what they push, and the expansions behind them.

Where a kink is, x, follows from the polynomial g that is zero there: dx = -dg(x) / g'(x). Both branches agree
in value and slope there, so that little comes through x. The rest are the shift of the series to x, the
expansion on the new branch, and the moments

    change_q = sum_k c_k left^(k+q) k! / (k+q)!,    d change_q / d left = change_q-1

of the difference c of the new and the old series of z.

Where z is expanded anew for the sake of its polynomial alone, both series are solutions of one equation, to
the error of the polynomials: that place is taken to be fixed.
"""

from functools import cache

from pymc_features.simulators.compiled.jit import jit, unrolled
from pymc_features.simulators.numbers.compiled_numbers import magnitude, where_less
from pymc_features.simulators.numbers.vectors import LANES, load, read_number, splat, store, write_number
from pymc_features.simulators.taylor.adjoint.orders import bars_of
from pymc_features.simulators.taylor.adjoint.series import add_coefficient
from pymc_features.simulators.taylor.kinks import (
    HIT,
    IS_FIRST,
    KINK,
    LANE,
    LEFT,
    N_PAIRS,
    PLACE,
    RATE_SIGN_BEHIND,
    TRACE_HEADER,
    TURNS,
    WHERE,
    Z_SIGN_BEHIND,
    batch_size,
    trace_size,
)
from pymc_features.simulators.taylor.layout import CHANGE, N_MOMENTS, Z_END, add_lanes, layout_of
from pymc_features.simulators.taylor.series import RATE, Spring, Z, coefficient, write_coefficient

TINY = 1e-14  # what is left of a step behind a kink at its end


def batch_bars_of(series):
    """The recurrence with all series of bars of the pairs in a batch, for their layout."""
    return series._replace(n_series=series.adjoint.n_series + 1)


def bars_size(series) -> int:
    """Vectors of the bars of a batch: a record, the bars of the shifted series of z, and two more."""
    layout = layout_of(batch_bars_of(series))
    return layout.record + layout.length + 2


@cache
def expansion_adjoint(series, k):
    """Return the function that carries bars of z back through an expansion, from order k down."""
    expand, rest = unrolled(series.adjoint.expand), expansion_adjoint(series, k - 1) if k > 0 else None
    sums, begins, order = jit(series.adjoint.sums), k == series.order - 1, series.order

    @jit
    def expansion(spring, bars, loading, sign):
        if begins:
            write_coefficient(bars, Z, order, coefficient(bars, Z, order) * splat(1.0 / order))
        _, rate_bar, z_bar = expand(spring, bars, k, splat(0.0))
        add_coefficient(bars, RATE, k, rate_bar)
        write_coefficient(bars, Z, k, (coefficient(bars, Z, k) + z_bar) * splat(1.0 / max(k, 1)))
        if rest is not None:
            rest(spring, bars, loading, sign)
        else:
            sums(spring, bars, None, loading, sign)

    return expansion


@cache
def turns_adjoint(series):
    """Return the function that carries bars back through all entries of a trace."""
    length, record, entries, constants = layout_of(series)
    _, own_record, own_entries, own_constants = layout_of(batch_bars_of(series))
    _, kept_record, kept_entries, kept_constants = layout_of(bars_of(series))
    order, size, turn_size = series.order, batch_size(series), trace_size(series, 0)
    rates, zs, old, more = length * (1 + RATE), length * (1 + Z), record, record + length
    shifted, done_at, by_z_at = own_record, own_record + length, own_record + length + 1
    unexpand, tangent = expansion_adjoint(series, order - 1), jit(series.tangent)
    untangent = jit(series.adjoint.tangent)

    @jit
    def gather(at, batch, bars, count):
        """Begin a batch with the bars of what its pairs changed."""
        for c in range(length):
            store(batch, rates + c, splat(0.0))
            store(batch, zs + c, splat(0.0))
            store(batch, shifted + c, splat(0.0))
        for c in range(own_entries + CHANGE, own_record):
            store(batch, c, splat(0.0))
        store(batch, done_at, splat(0.0))
        for lane in range(count):
            place = int(read_number(at, (more + PLACE) * LANES + lane))
            there = place // record * kept_record
            own = int(read_number(at, (more + LANE) * LANES + lane))
            for c in range(CHANGE, CHANGE + 1 + N_MOMENTS):
                change = read_number(bars, (there + kept_entries + c) * LANES + own)
                write_number(batch, (own_entries + c) * LANES + lane, change)

    @jit
    def scatter(at, batch, bars, count, z_end):
        """Add what a batch has found to the bars of its pairs."""
        store(batch, done_at, z_end)
        for lane in range(count):
            place = int(read_number(at, (more + PLACE) * LANES + lane))
            there = place // record * kept_record
            own = int(read_number(at, (more + LANE) * LANES + lane))
            of_end = read_number(batch, done_at * LANES + lane)
            for k in range(length):
                to, value = (there + rates + k) * LANES + own, read_number(batch, (rates + k) * LANES + lane)
                write_number(bars, to, read_number(bars, to) + value)
                to, value = (there + zs + k) * LANES + own, read_number(batch, (zs + k) * LANES + lane)
                write_number(bars, to, read_number(bars, to) + value + of_end)
            for c in range(own_record - own_constants):
                to, value = (there + kept_constants + c) * LANES + own, (own_constants + c) * LANES + lane
                write_number(bars, to, read_number(bars, to) + read_number(batch, value))

    @jit
    def reverse_moments(at, batch, hit, left, is_last):
        """Split the bars of z into those of the new series and of the old one; return that by `left`."""
        e0 = e1 = e2 = e3 = e4 = slope = splat(0.0)
        for k in range(order, 0, -1):
            c = hit * (load(at, zs + k) - load(at, old + k))
            i1 = 1.0 / (k + 1)
            i2 = i1 / (k + 2)
            i3 = i2 / (k + 3)
            slope = slope * left + c * float(k)
            e0 = e0 * left + c
            e1 = e1 * left + c * i1
            e2 = e2 * left + c * i2
            e3 = e3 * left + c * i3
            e4 = e4 * left + c * (i3 / (k + 4))
        change = own_entries + CHANGE
        b0, b1, b2 = (load(batch, change), load(batch, change + 1), load(batch, change + 2))
        b3, b4 = load(batch, change + 3), load(batch, change + 4)
        m0 = e0 * left
        power = left * left
        m1 = e1 * power
        power = power * left
        m2 = e2 * power
        power = power * left
        m3 = e3 * power
        m4 = e4 * power * left
        if is_last:  # the moments are multiplied by df/dz at the end; bars are those of the force until then
            spring = Spring(at, length, length, constants)
            by_z = tangent(spring, load(at, entries + Z_END))[2]
            there = entries + CHANGE
            of_by_z = b1 * (m1 + load(at, there + 1)) + b2 * (m2 + load(at, there + 2))
            of_by_z = of_by_z + b3 * (m3 + load(at, there + 3)) + b4 * (m4 + load(at, there + 4))
            store(batch, by_z_at, of_by_z)
            b1, b2, b3, b4 = by_z * b1, by_z * b2, by_z * b3, by_z * b4
            for c, b in enumerate((b1, b2, b3, b4)):
                store(batch, change + 1 + c, b)
        of_left = b0 * slope + b1 * m0 + b2 * m1 + b3 * m2 + b4 * m3
        power = left
        for k in range(1, order + 1):
            i1 = 1.0 / (k + 1)
            i2 = i1 / (k + 2)
            i3 = i2 / (k + 3)
            inner = b3 * i3 + left * (b4 * (i3 / (k + 4)))
            bar = power * hit * (b0 + left * (b1 * i1 + left * (b2 * i2 + left * inner)))
            power = power * left
            z_bar = load(batch, zs + k)
            store(batch, shifted + k, (1.0 - hit) * z_bar - bar)
            store(batch, zs + k, hit * z_bar + bar)
        return of_left * hit

    @jit
    def reverse_shift(at, batch, given):
        """Carry the bars of both shifted series back to those before, and through the kink's place."""
        x, left, kink, turns = given
        zero, of_x = splat(0.0), load(batch, done_at)
        store(batch, shifted, load(batch, zs))
        for k in range(order):
            rate = (k + 1.0) * load(at, rates + k + 1)
            of_x = of_x + load(batch, rates + k) * rate
            of_x = of_x + load(batch, shifted + k) * ((k + 1.0) * load(at, old + k + 1))
        for i in range(order - 1, -1, -1):
            c, d = load(batch, rates + i), load(batch, shifted + i)
            for j in range(i, order):
                c = load(batch, rates + j + 1) + x * c
                d = load(batch, shifted + j + 1) + x * d
                store(batch, rates + j + 1, c)
                store(batch, shifted + j + 1, d)
        inside = kink * where_less(splat(TINY), left, splat(1.0), zero)
        at_end = kink - inside  # x = 1 - what has been done
        store(batch, done_at, load(batch, done_at) - at_end * of_x)
        slope = where_less(zero, turns, load(at, rates + 1), load(at, old + 1))
        root = where_less(splat(1e-200), magnitude(slope), inside * of_x / slope, zero)
        for k in range(length):
            of_rate = turns * root
            add_lanes(batch, rates + k, zero - of_rate)
            store(batch, zs + k, load(batch, shifted + k) - (root - of_rate))
            root = root * x

    @jit
    def reverse_turns(bars, batch, trace):
        """Carry bars back through all kinks of a step, the last first."""
        is_last = True
        for number in range(int(read_number(trace, 0)) - 1, -1, -1):
            at = trace + 8 * LANES * (TRACE_HEADER + number * turn_size)
            x, left = load(at, size + WHERE), load(at, size + LEFT)
            hit, kink = load(at, size + HIT), load(at, size + KINK)
            turns = kink * load(at, size + TURNS)
            count = int(read_number(at, (size + N_PAIRS) * LANES))
            if is_last:
                gather(at, batch, bars, count)
            of_left = reverse_moments(at, batch, hit, left, is_last)
            add_lanes(batch, done_at, splat(0.0) - of_left)
            spring = Spring(at, length, length, constants)
            of_spring = Spring(batch, length, length, own_constants)
            z_sign = load(at, size + Z_SIGN_BEHIND)
            loading = load(at, size + RATE_SIGN_BEHIND) * z_sign
            unexpand(spring, of_spring, loading, z_sign)
            if is_last:
                z_end = load(at, entries + Z_END)
                zero, of_by_z = splat(0.0), load(batch, by_z_at)
                of_end = untangent(spring, of_spring, z_end, (zero, zero, of_by_z), loading, z_sign)
                store(batch, by_z_at, of_end)
            reverse_shift(at, batch, (x, left, kink, turns))
            is_last = read_number(at, (size + IS_FIRST) * LANES) > 0.0
            if is_last:  # the next one is the last of another batch
                scatter(at, batch, bars, count, load(batch, by_z_at))

    return reverse_turns
