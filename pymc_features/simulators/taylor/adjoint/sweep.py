"""Gradient of the statistics of the misfits of a group of chains: its march in reverse.

It is the derivative of what the march computes, with the choices that it made: numbers of steps, branches,
springs with kinks. From the last step to the first the state at its beginning is taken from the tape, the
step is repeated, and the bars of its end become those of its beginning.
"""

from functools import cache
from typing import NamedTuple

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import (
    aligned,
    read_lanes,
    read_number,
    write_lanes,
)
from pymc_features.simulators.oscillators.arguments import (
    RELATIVE_DISPLACEMENT,
    RELATIVE_VELOCITY,
)
from pymc_features.simulators.taylor.adjoint.kinks import bars_size
from pymc_features.simulators.taylor.adjoint.orders import OF_U, bars_of, passing_size
from pymc_features.simulators.taylor.adjoint.parameters import ChainBars
from pymc_features.simulators.taylor.adjoint.step import step_adjoint
from pymc_features.simulators.taylor.kinks import trace_size
from pymc_features.simulators.taylor.layout import (
    DASHPOT,
    DRAG,
    MOBILITY,
    V_END,
    add_lanes,
    group_size,
    layout_of,
)
from pymc_features.simulators.taylor.march import group_of
from pymc_features.simulators.taylor.tape import COUNT, COUNTS, SEGMENTS, STEPS, tape_of, width_of


class Bars(NamedTuple):
    """Addresses of what a gradient needs besides the group and its tape.

    Attributes
    ----------
    bars : address of vectors
        Bars of the group, in the layout of `adjoint.orders.bars_of`.
    modal : address
        Bars of H M^-1 C (n, n), 0 without damping by modal ratios.
    batch, kinks, trace, before : addresses
        A batch of pairs with kinks, its bars, what is traced of it, and z before the kinks of others.
    weights : address
        Of vectors (sensor, n_statistics).
    n_statistics : int
    """

    bars: int
    modal: int
    batch: int
    kinks: int
    trace: int
    before: int
    weights: int
    n_statistics: int


@cache
def misfits_of(series):
    """Return the function that adds the bars of a sample's misfits, and the one that forgets them."""
    own = layout_of(bars_of(series)).record

    @jit
    def weigh(memory, tape, sample, step, wanted, observed):
        n_sensors, total = observed.shape
        share, count = 2.0 / total, memory.n_statistics
        for j in range(n_sensors):
            here, at = (wanted.sensors[j] + 1) * own, sample * n_sensors + j
            misfit, weights = read_lanes(tape.misfits, at), memory.weights + 8 * LANES * j * count
            bar = splat(0.0)
            if observed[j, sample] == observed[j, sample]:  # NaN is a gap
                bar = share * read_lanes(weights, 0) * misfit
            if count > 1:
                change = splat(0.0)
                if sample > 0:
                    change = misfit - read_lanes(tape.misfits, at - n_sensors)
                else:
                    bar = bar + read_lanes(weights, 2)
                if sample < total - 1:
                    change = change - (read_lanes(tape.misfits, at + n_sensors) - misfit)
                else:
                    bar = bar + read_lanes(weights, 3)
                bar = bar + share * read_lanes(weights, 1) * change
            if wanted.quantity == RELATIVE_DISPLACEMENT:
                add_lanes(memory.bars, here + OF_U, 0.0 - bar)
            elif wanted.quantity == RELATIVE_VELOCITY:
                add_lanes(memory.bars, here, bar * splat(-1.0 / step))
            else:
                add_lanes(memory.bars, here + 1, bar * splat(-1.0 / (step * step)))

    @jit
    def forget(memory, wanted):
        for j in range(wanted.sensors.size):
            for c in range(OF_U + 1):
                write_lanes(memory.bars, (wanted.sensors[j] + 1) * own + c, splat(0.0))

    return weigh, forget


@cache
def sweep_of(series):
    """Return the function that takes bars from the end of a march to its beginning."""
    rescale, _, put_load, _, advance = group_of(series)
    _, own, entries, _ = layout_of(bars_of(series))
    (keep, restore, _, _), width = tape_of(series), width_of(series)
    reverse_step, reverse_end = step_adjoint(series)
    weigh, forget = misfits_of(series)

    @jit
    def rescale_bars(group, memory, ratio):
        """Bars for a step that is longer by a ratio."""
        n, factor, inverse = group.n, splat(ratio), splat(1.0 / ratio)
        for i in range(1, n + 1):
            at = i * own + entries
            write_lanes(memory.bars, at + V_END, inverse * read_lanes(memory.bars, at + V_END))
            write_lanes(memory.bars, at + DASHPOT, factor * read_lanes(memory.bars, at + DASHPOT))
        end = (n + 1) * own + DRAG
        write_lanes(memory.bars, end, inverse * read_lanes(memory.bars, end))
        if group.modal != 0:
            for i in range(n * n):
                write_lanes(memory.modal, i, inverse * read_lanes(memory.modal, i))

    @jit
    def count_of(tape, span):
        return int(read_number(tape.numbers, COUNTS + span))

    @jit
    def step_of(spans, tape, span):
        return spans.step * spans.widths[span] / count_of(tape, span)

    @jit
    def march_again(group, memory, tape, segment, last, step, spans):
        """March through a segment, to span `last`, and keep its states on the tape."""
        first = int(read_number(tape.numbers, COUNTS + tape.n_spans + segment))
        slot = 0
        for span in range(first, last + 1):
            rescale(group, step_of(spans, tape, span) / step)
            step, count = step_of(spans, tape, span), count_of(tape, span)
            if span == first:
                start = tape.starts + 8 * LANES * (segment * group.n * width)
                restore(group, start, group.n, group.n)
            for part in range(count):
                keep(group, tape.states, slot)
                put_load(group, spans, span, part, count)
                advance(group, False, memory.batch)
                slot += 1
        return slot

    @jit
    def sweep(group, memory, tape, spans, wanted, observed):
        """Write the bars of a group that has just been marched; return the step [s] of its first span."""
        sample, n_spans = observed.shape[1] - 1, spans.widths.size - 1
        count = int(read_number(tape.numbers, COUNT))
        step = step_of_bars = spans.step * spans.widths[n_spans] / count
        weigh(memory, tape, sample, step, wanted, observed)
        put_load(group, spans, n_spans, 0, count)
        reverse_end(group, memory)
        forget(memory, wanted)
        last, slot = n_spans - 1, int(read_number(tape.numbers, STEPS))
        for segment in range(int(read_number(tape.numbers, SEGMENTS)) - 1, -1, -1):
            first = int(read_number(tape.numbers, COUNTS + tape.n_spans + segment))
            if last < n_spans - 1:
                slot = march_again(group, memory, tape, segment, last, step, spans)
                step = step_of(spans, tape, last)
            for span in range(last, first - 1, -1):
                count, now = count_of(tape, span), step_of(spans, tape, span)
                if now != step:
                    rescale(group, now / step)
                    step = now
                if now != step_of_bars:
                    rescale_bars(group, memory, now / step_of_bars)
                    step_of_bars = now
                if span < spans.first[sample]:
                    sample -= 1
                for part in range(count - 1, -1, -1):
                    slot -= 1
                    put_load(group, spans, span, part, count)
                    is_sample = part == 0 and span == spans.first[sample]
                    if is_sample:
                        weigh(memory, tape, sample, step, wanted, observed)
                    reverse_step(group, memory, tape.states, slot)
                    if is_sample:
                        forget(memory, wanted)
            last = first - 1
        return step_of_bars

    return sweep


class GradientLanes:
    """Memory of the gradient of a group of chains, beside that of the group."""

    def __init__(self, lanes, n_sensors, n_statistics):
        series, self.n = lanes.series, lanes.n
        n = self.n
        own = bars_of(series)
        self.layout = layout_of(own)
        size = group_size(own, n) + passing_size(series, n, lanes.modal.size > 0)
        self.bars = aligned(size * LANES).reshape(-1, LANES)
        self.modal = aligned(lanes.modal.size)
        kinks = series.branch is not None
        self.batch = aligned(bars_size(series) * LANES if kinks else 0)
        self.trace = aligned(trace_size(series, n) * LANES if kinks else 0)
        self.before = aligned(3 * (n + 1) * LANES)
        self.weights = aligned(n_sensors * n_statistics * LANES).reshape(n_sensors, n_statistics, LANES)
        memories = self.bars, self.modal, lanes.batch, self.batch, self.trace, self.before, self.weights
        self.memory = Bars(*(m.ctypes.data for m in memories), n_statistics)

    def take(self, step) -> ChainBars:
        """What a sweep has found, with the step [s] that its first sample had."""
        n, layout = self.n, self.layout
        springs = self.bars[layout.record : (n + 1) * layout.record].reshape(n, layout.record, LANES)
        entries, modal = springs[:, layout.entries :], self.modal.reshape(-1, LANES)
        side = n if len(modal) else 0
        return ChainBars(
            entries[:, MOBILITY].T.copy(),
            entries[:, DASHPOT].T / step,
            self.bars[(n + 1) * layout.record + DRAG] * step,
            springs[:, layout.constants :].transpose(2, 0, 1).copy(),
            modal.reshape(side, side, LANES).transpose(2, 0, 1) * step,
        )

    def clear(self, weights):
        """Begin a sweep with weights (p, s, q), one particle in each lane."""
        self.bars[:] = self.modal[:] = 0.0
        self.weights[:] = weights.transpose(1, 2, 0)
