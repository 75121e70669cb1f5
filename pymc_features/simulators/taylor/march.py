"""Groups of chains through a record by Taylor steps, and the statistics of their misfits.

All chains of a march take the same steps, so many to a span of the record (`ground/spans.py`) as the last
coefficients say: with the largest, |V_P|, and the largest acceleration A of its mass so far, a step is
accurate where |V_P| / (H^2 A) is below the tolerance of the recurrence. The ratio grows as H^(P - 1). Where
it has been exceeded by far the steps are taken once more, shorter. Their number falls by a third at most at a
time: while a spring flows the coefficients are small, but long steps would not be stable. It falls from two
to one where that is enough, with kinks where it is by far. A chain that asks for more than `MAX_STEPS` is
lost: NaN, and left to others.

Which springs of a group have kinks in a step: they go into batches, see `kinks.py`.

A step of a chain, one block of springs after the other, from the highest down.

The coefficients of thirty masses do not fit into the first cache. Order k of a spring needs order k - 1 of it
and of the spring below, so that the orders of a block can follow each other where every one of them stays one
spring behind the order before it; so do the sums at the end of the step, and the search for kinks. Damping by
modal ratios couples all masses in every order: then the chain is one block.
"""

from functools import cache

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import highest, larger, magnitude, where_less
from pymc_features.simulators.numbers.vectors import (
    LANES,
    any_less,
    first_lane,
    lanes_less,
    load,
    read_number,
    splat,
    store,
    write_number,
)
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_DISPLACEMENT,
    RELATIVE_VELOCITY,
)
from pymc_features.simulators.taylor.feedback import feedback_of
from pymc_features.simulators.taylor.ground import DEGREE, SHARE
from pymc_features.simulators.taylor.kinks import LANE, N_BATCH_ENTRIES, OWNER, PLACE, RATE_END, turn_of
from pymc_features.simulators.taylor.layout import (
    CHANGE,
    COUNT,
    CURVED,
    DASHPOT,
    DRAG,
    FIRST,
    HARMLESS,
    HAS_KINK,
    KINK_ERROR,
    LAST,
    LAST_Z,
    LOST,
    MAX_STEPS,
    MOBILITY,
    N_MOMENTS,
    PEAK,
    RATE_SIGN,
    V_END,
    Z_END,
    Z_SIGN,
    U,
    add_lanes,
    layout_of,
    load_of,
    tape_of,
)
from pymc_features.simulators.taylor.orders import HUGE, finish_of, orders_from
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
            store(batch, c, splat(number))
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
            rate_sign, z_sign = load(address, at + RATE_SIGN), load(address, at + Z_SIGN)
            rate_end = load(address, at + V_END) - load(address, at + V_END - record)
            a, b = rate_end * rate_sign, load(address, at + Z_END) * z_sign
            lowest = where_less(a, b, a, b)
            start = load(address, here + rates) + load(address, here + rates + 1)
            start = start * rate_sign
            lowest = where_less(start, lowest, start, lowest)
            if pieces is not None:
                spring = Spring(address, here + length, length, here + constants)
                away = constant_of(spring, pieces.sign) * load(address, at + Z_END)
                away = magnitude(away - constant_of(spring, pieces.middle))
                hold = constant_of(spring, pieces.hold)
                hold = where_less(constant_of(spring, pieces.half), away, zero, hold)
                write_constant(spring, pieces.hold, hold)
                lowest = where_less(hold, splat(1.0), splat(-1.0), lowest)
            has_kink = any_less(lowest, zero)
            write_number(address, (at + HAS_KINK) * LANES, 1.0 if has_kink else 0.0)
            if has_kink:
                for c in range(CHANGE, CHANGE + 1 + N_MOMENTS):
                    store(address, at + c, zero)
                store(batch, flags, rate_end)
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


BLOCK = 8  # springs, whose coefficients fill half of a first cache of 32 KB
SHORT = 16  # springs of a chain that is one block: those of two would be read as often


@cache
def series_of(series, repeats):
    """Return the function that expands all series of a step, and sums them up.

    One that `repeats` a step takes its beginning from a tape. It leaves the displacements there, and sums up
    what the search for kinks needs.

    It returns the number of pairs with kinks that wait in the batch.
    """
    first, others, order = orders_from(series, 0), orders_from(series, 1), series.order
    finish, kinks, restore = finish_of(series, not repeats), series.branch is not None, tape_of(series)[1]
    search = search_of(series) if kinks else None

    @jit
    def expand(group, begun, batch, trace):
        """`begun` tells whether order 0 is done; in a step that is repeated: the address of its beginning."""
        address, _, modal, n = group
        largest = n if modal != 0 or n <= SHORT else BLOCK
        high, count = n, 0
        while high > 0:
            size = largest if high > largest else high
            if repeats:  # and the spring below as well
                top = high if high == n else high - 1
                restore(group, begun, top, size + top - high + (1 if size < high else 0))
            if repeats or not begun:
                first(address, modal, n, high, size)
            top = high + 1 if high + 1 < n else n
            others(address, modal, n, top, size - 1 + top - high if size < high else top)
            if kinks or not repeats:
                top = high + order if high + order < n else n
                finish(address, n, top, size - order + top - high if size < high else top)
            if kinks:
                top = high + order + 1 if high + order + 1 < n else n
                own = size - order - 1 + top - high if size < high else top
                count = search(address, top, own, batch, count, trace)
            high -= size
        return count

    return expand


TOO_FAR = 10.0  # above the tolerance: steps are repeated
LARGEST_Z = 1e-2  # last coefficient of z: above it the series are of no use
LARGEST_KINK_ERROR = 1e-7  # of z behind kinks (`feedback.py`): above it steps are repeated


@cache
def group_of(series):
    """Return functions of one group: rescale, keep or bring back the state, put a load on, take a step."""
    (_, record, entries, _), load_at = layout_of(series), load_of(series)
    first, expand, kinks = orders_from(series, 0), series_of(series, False), series.branch is not None
    if kinks:
        turn, apply = turn_of(series), feedback_of(series)

    @jit
    def rescale(group, ratio):
        """Make the step longer by a ratio."""
        address, kept, modal, n = group
        inverse, squared = splat(1.0 / ratio), splat(ratio * ratio)
        factor = splat(ratio)
        for i in range(1, n + 1):
            at = i * record + entries
            store(address, at + V_END, factor * load(address, at + V_END))
            store(address, at + MOBILITY, squared * load(address, at + MOBILITY))
            store(address, at + DASHPOT, inverse * load(address, at + DASHPOT))
        end = (n + 1) * record
        store(address, end + DRAG, factor * load(address, end + DRAG))
        if modal != 0:
            for i in range(n * n):
                store(modal, i, factor * load(modal, i))

    @jit
    def copy(group, back):
        """Keep the largest acceleration, and u, H v, z and the signs of all springs, or bring them back."""
        address, kept, _, n = group
        peak = (n + 1) * record + PEAK
        if back:
            store(address, peak, load(kept, 0))
        else:
            store(kept, 0, load(address, peak))
        for i in range(1, n + 1):
            at = i * record + entries
            places = (at + V_END, at + U)
            if kinks:
                places = (at + V_END, at + U, at + Z_END, at + RATE_SIGN, at + Z_SIGN)
            for c in range(len(places)):
                if back:
                    store(address, places[c], load(kept, 5 * i + c))
                else:
                    store(kept, 5 * i + c, load(address, places[c]))

    @jit
    def put_load(group, spans, span, part, count):
        """Make the ground acceleration in one of `count` parts of a span the load."""
        address, at, inverse = group.address, (group.n + 1) * record + load_at, 1.0 / count
        step = spans.step * spans.widths[span] * inverse
        if spans.widths[span] == 1:
            rise = spans.loads[span, 1] * inverse
            store(address, at, splat(step * step * (spans.loads[span, 0] + part * rise)))
            store(address, at + 1, splat(step * step * rise))
            if read_number(address, (at + CURVED) * LANES) > 0.0:
                store(address, at + HARMLESS, splat(0.0))
                write_number(address, (at + CURVED) * LANES, 0.0)
            return
        share = step * step
        for k in range(DEGREE + 1):
            store(address, at + k, splat(share * spans.loads[span, k]))
            share *= inverse
        for i in range(DEGREE if part > 0 else 0):
            for k in range(DEGREE - 1, i - 1, -1):
                add_lanes(address, at + k, part * load(address, at + k + 1))
        harmless = (1.0 - min(SHARE * (spans.rate * step) ** 2, 1.0)) / (DEGREE + 1)
        store(address, at + HARMLESS, harmless * load(address, at + DEGREE))
        write_number(address, (at + CURVED) * LANES, 1.0)

    @jit
    def begin(group):
        """Coefficients 1 of the velocities."""
        first(group.address, group.modal, group.n, group.n, group.n)

    @jit
    def advance(group, has_begun, batch):
        """Take a step under the load that has been put on."""
        count = expand(group, has_begun, batch, None)
        if kinks:
            if count > 0:
                turn(batch, count, None)
            apply(group.address, group.modal, group.n, None)

    return rescale, copy, put_load, begin, advance


@cache
def march_of(series):
    """Return the function that takes groups of chains through a record."""
    _, record, entries, _ = layout_of(series)
    rescale, copy, put_load, begin, advance = group_of(series)
    keep, _, accept, first_free = tape_of(series)
    order, tolerance = series.order, series.tolerance
    kinks = series.branch is not None
    enough = 0.25 if kinks else 1.0  # kinks of neighbours want to be apart

    @jit
    def needed(group, step, most):
        """Largest ratio of last coefficients to the tolerance; a chain beyond `most` is lost."""
        address, n = group.address, group.n
        end = (n + 1) * record
        largest = load(address, end + FIRST) * splat(1.0 / (step * step))
        peak = larger(load(address, end + PEAK), largest)
        scale = splat(tolerance * step * step) * peak + 1e-300
        ratio = load(address, end + LAST) / scale
        ratio = larger(ratio, load(address, end + LAST_Z) * splat(1.0 / LARGEST_Z))
        if kinks:
            error = load(address, end + KINK_ERROR) * splat(TOO_FAR / LARGEST_KINK_ERROR)
            ratio = larger(ratio, where_less(splat(TOO_FAR), error, error, splat(0.0)))
            store(address, end + KINK_ERROR, splat(0.0))
        ratio = where_less(ratio, splat(HUGE), ratio, splat(0.5 * HUGE))  # steps not finite are repeated too
        lost = where_less(ratio, splat(most), load(address, end + LOST), splat(1.0))
        store(address, end + LOST, lost)
        store(address, end + PEAK, peak)
        store(address, end + FIRST, splat(0.0))
        store(address, end + LAST, splat(0.0))
        store(address, end + LAST_Z, splat(0.0))
        return highest(where_less(lost, splat(0.5), ratio, splat(0.0)))

    @jit
    def compare(group, support, step, sample, wanted, observed, sums, tape):
        """Add the misfits at the sensors to `sums`, four vectors for each of them.

        `support` is the acceleration to add to those relative to the load: that of the load, less that of the
        record if they are wanted relative to it.
        """
        address = group.address
        share = splat(1.0 / observed.shape[1])
        for j in range(wanted.sensors.size):
            here = (wanted.sensors[j] + 1) * record
            if wanted.quantity == RELATIVE_DISPLACEMENT:
                value = load(address, here + entries + U)
            elif wanted.quantity == RELATIVE_VELOCITY:
                value = load(address, here) * splat(1.0 / step)
            else:
                value = load(address, here + 1) * splat(1.0 / (step * step))
                value = value + support
            misfit = observed[j, sample] - value
            if observed[j, sample] == observed[j, sample]:  # NaN is a gap
                store(sums, 4 * j, load(sums, 4 * j) + misfit * misfit * share)
            if sample == 0:
                store(sums, 4 * j + 2, misfit)
            else:
                change = misfit - load(sums, 4 * j + 3)
                store(sums, 4 * j + 1, load(sums, 4 * j + 1) + change * change * share)
            store(sums, 4 * j + 3, misfit)
            if tape.capacity > 0:
                store(tape.misfits, sample * wanted.sensors.size + j, misfit)

    @jit
    def divide(group, step, length):
        """Return the number of steps to spans of another length; they are about as long as before."""
        count = max(min(int(length / step), MAX_STEPS), 1)
        rescale(group, length / count / step)
        return count

    @jit
    def march(group, batch, sums, start, spans, wanted, observed, tape):
        """Write the statistics of the misfits; `start` is the number of steps to begin with."""
        count, total = start, observed.shape[1]
        length = spans.step * spans.widths[0]
        step = length / count
        steps = slot = 0
        for sample in range(total):
            span = spans.first[sample]
            if spans.step * spans.widths[span] != length:
                length = spans.step * spans.widths[span]
                count = divide(group, step, length)
                step = length / count
            put_load(group, spans, span, 0, count)
            begin(group)
            support = spans.loads[span, 0]
            if wanted.quantity != ABSOLUTE_ACCELERATION:
                support -= spans.ground[sample]
            compare(group, support, step, sample, wanted, observed, sums, tape)
            if sample == total - 1:
                break
            begun = True
            while span < spans.first[sample + 1]:
                copy(group, False)
                if tape.capacity > 0:
                    slot = first_free(tape)
                while True:
                    for part in range(count):
                        if tape.capacity > 0:
                            keep(group, tape.states, slot + part)
                        if not begun:  # otherwise it has been put on
                            put_load(group, spans, span, part, count)
                        advance(group, begun, batch)
                        begun = False
                    steps += count
                    ratio = needed(group, step, HUGE if count < MAX_STEPS else TOO_FAR)
                    asked = count * max(ratio, 1e-12) ** (1.0 / (order - 1))
                    better = max(int(min(np.ceil(asked), MAX_STEPS)), (2 * count + 2) // 3)
                    if count == 2 and asked < enough:
                        better = 1
                    repeat = ratio > TOO_FAR and better > count
                    if repeat:
                        copy(group, True)
                    elif tape.capacity > 0:
                        accept(group, tape, span, count)
                    if better != count:
                        rescale(group, count / better)
                        count = better
                        step = length / count
                    if not repeat:
                        break
                    copy(group, False)  # in terms of the new step
                span += 1
        if tape.capacity > 0:
            write_number(tape.numbers, COUNT, float(count))
        return steps

    return march
