"""Groups of chains through a record by Taylor steps, and the statistics of their misfits.

All chains of a march take the same steps, so many to a span of the record (`ground/spans.py`) as the last
coefficients say: with the largest, |V_P|, and the largest acceleration A of its mass so far, a step is
accurate where |V_P| / (H^2 A) is below the tolerance of the recurrence. The ratio grows as H^(P - 1). Where
it has been exceeded by far the steps are taken once more, shorter. Their number falls by a third at most at a
time: while a spring flows the coefficients are small, but long steps would not be stable. It falls from two
to one where that is enough, with kinks where it is by far. A chain that asks for more than `MAX_STEPS` is
lost: NaN, and left to others.
"""

from functools import cache

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, highest, splat, where_less
from pymc_features.simulators.compiled.vector_math import larger
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number, write_lanes, write_number
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_DISPLACEMENT,
    RELATIVE_VELOCITY,
)
from pymc_features.simulators.taylor.blocks import series_of
from pymc_features.simulators.taylor.feedback import feedback_of
from pymc_features.simulators.taylor.ground.projection import DEGREE
from pymc_features.simulators.taylor.ground.spans import SHARE
from pymc_features.simulators.taylor.kinks import turn_of
from pymc_features.simulators.taylor.layout import (
    CURVED,
    DASHPOT,
    DRAG,
    FIRST,
    HARMLESS,
    KINK_ERROR,
    LAST,
    LAST_Z,
    LOST,
    MOBILITY,
    PEAK,
    RATE_SIGN,
    V_END,
    Z_END,
    Z_SIGN,
    U,
    add_lanes,
    layout_of,
    load_of,
)
from pymc_features.simulators.taylor.orders import HUGE, orders_from
from pymc_features.simulators.taylor.tape import COUNT, MAX_STEPS, tape_of

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
            write_lanes(address, at + V_END, factor * read_lanes(address, at + V_END))
            write_lanes(address, at + MOBILITY, squared * read_lanes(address, at + MOBILITY))
            write_lanes(address, at + DASHPOT, inverse * read_lanes(address, at + DASHPOT))
        end = (n + 1) * record
        write_lanes(address, end + DRAG, factor * read_lanes(address, end + DRAG))
        if modal != 0:
            for i in range(n * n):
                write_lanes(modal, i, factor * read_lanes(modal, i))

    @jit
    def copy(group, back):
        """Keep the largest acceleration, and u, H v, z and the signs of all springs, or bring them back."""
        address, kept, _, n = group
        peak = (n + 1) * record + PEAK
        if back:
            write_lanes(address, peak, read_lanes(kept, 0))
        else:
            write_lanes(kept, 0, read_lanes(address, peak))
        for i in range(1, n + 1):
            at = i * record + entries
            places = (at + V_END, at + U)
            if kinks:
                places = (at + V_END, at + U, at + Z_END, at + RATE_SIGN, at + Z_SIGN)
            for c in range(len(places)):
                if back:
                    write_lanes(address, places[c], read_lanes(kept, 5 * i + c))
                else:
                    write_lanes(kept, 5 * i + c, read_lanes(address, places[c]))

    @jit
    def put_load(group, spans, span, part, count):
        """Make the ground acceleration in one of `count` parts of a span the load."""
        address, at, inverse = group.address, (group.n + 1) * record + load_at, 1.0 / count
        step = spans.step * spans.widths[span] * inverse
        if spans.widths[span] == 1:
            rise = spans.loads[span, 1] * inverse
            write_lanes(address, at, splat(step * step * (spans.loads[span, 0] + part * rise)))
            write_lanes(address, at + 1, splat(step * step * rise))
            if read_number(address, (at + CURVED) * LANES) > 0.0:
                write_lanes(address, at + HARMLESS, splat(0.0))
                write_number(address, (at + CURVED) * LANES, 0.0)
            return
        share = step * step
        for k in range(DEGREE + 1):
            write_lanes(address, at + k, splat(share * spans.loads[span, k]))
            share *= inverse
        for i in range(DEGREE if part > 0 else 0):
            for k in range(DEGREE - 1, i - 1, -1):
                add_lanes(address, at + k, part * read_lanes(address, at + k + 1))
        harmless = (1.0 - min(SHARE * (spans.rate * step) ** 2, 1.0)) / (DEGREE + 1)
        write_lanes(address, at + HARMLESS, harmless * read_lanes(address, at + DEGREE))
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
        largest = read_lanes(address, end + FIRST) * splat(1.0 / (step * step))
        peak = larger(read_lanes(address, end + PEAK), largest)
        scale = splat(tolerance * step * step) * peak + 1e-300
        ratio = read_lanes(address, end + LAST) / scale
        ratio = larger(ratio, read_lanes(address, end + LAST_Z) * splat(1.0 / LARGEST_Z))
        if kinks:
            error = read_lanes(address, end + KINK_ERROR) * splat(TOO_FAR / LARGEST_KINK_ERROR)
            ratio = larger(ratio, where_less(splat(TOO_FAR), error, error, splat(0.0)))
            write_lanes(address, end + KINK_ERROR, splat(0.0))
        ratio = where_less(ratio, splat(HUGE), ratio, splat(0.5 * HUGE))  # steps not finite are repeated too
        lost = where_less(ratio, splat(most), read_lanes(address, end + LOST), splat(1.0))
        write_lanes(address, end + LOST, lost)
        write_lanes(address, end + PEAK, peak)
        write_lanes(address, end + FIRST, splat(0.0))
        write_lanes(address, end + LAST, splat(0.0))
        write_lanes(address, end + LAST_Z, splat(0.0))
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
                value = read_lanes(address, here + entries + U)
            elif wanted.quantity == RELATIVE_VELOCITY:
                value = read_lanes(address, here) * splat(1.0 / step)
            else:
                value = read_lanes(address, here + 1) * splat(1.0 / (step * step))
                value = value + support
            misfit = observed[j, sample] - value
            if observed[j, sample] == observed[j, sample]:  # NaN is a gap
                write_lanes(sums, 4 * j, read_lanes(sums, 4 * j) + misfit * misfit * share)
            if sample == 0:
                write_lanes(sums, 4 * j + 2, misfit)
            else:
                change = misfit - read_lanes(sums, 4 * j + 3)
                write_lanes(sums, 4 * j + 1, read_lanes(sums, 4 * j + 1) + change * change * share)
            write_lanes(sums, 4 * j + 3, misfit)
            if tape.capacity > 0:
                write_lanes(tape.misfits, sample * wanted.sensors.size + j, misfit)

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
