"""Gradient of the statistics of the misfits of a group of chains: its march in reverse.

It is the derivative of what the march computes, with the choices that it made: numbers of steps, branches,
springs with kinks. From the last step to the first the state at its beginning is taken from the tape, the
step is repeated, and the bars of its end become those of its beginning.

A step of a chain in reverse, one block of springs after the other, as in `taylor/blocks.py`.

A step of a group of chains in reverse: it is repeated, and bars at its end become those at its start.

Gradients of a population of chains, `LANES` at a time.

From the bars of the numbers that a march works with to the gradient by the parameters of chains.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.vectors import (
    LANES,
    aligned,
    load,
    read_number,
    splat,
    store,
    write_number,
)
from pymc_features.simulators.oscillators.arguments import (
    RELATIVE_DISPLACEMENT,
    RELATIVE_VELOCITY,
)
from pymc_features.simulators.taylor.adjoint.kinks import bars_size, turns_adjoint
from pymc_features.simulators.taylor.adjoint.orders import (
    BLOCK,
    OF_U,
    bars_of,
    damping_bars,
    feedback_adjoint,
    passing_size,
    reverse_from,
    sums_of,
)
from pymc_features.simulators.taylor.feedback import feedback_of
from pymc_features.simulators.taylor.kinks import trace_size, turn_of
from pymc_features.simulators.taylor.layout import (
    COUNT,
    COUNTS,
    DASHPOT,
    DRAG,
    HAS_KINK,
    MOBILITY,
    RATE_SIGN,
    SEGMENTS,
    STEPS,
    V_END,
    Z_END,
    Z_SIGN,
    add_lanes,
    group_size,
    layout_of,
    signs_of,
    tape_memory,
    tape_of,
    width_of,
)
from pymc_features.simulators.taylor.march import group_of, series_of
from pymc_features.simulators.taylor.population import groups_of, modal_damping, modal_squares, rows_of
from pymc_features.simulators.taylor.series import RATE, Spring, Z

STEP = 1e-100  # of the complex step, which has no rounding error


def constants_gradient(series, stiffness, values, bars):
    """Derivatives by stiffness (p, n) and the law's parameters (p, rows, n), from `bars` (p, n, constants).

    By complex steps through `Series.constants`, or those of the adjoint, which do nothing but arithmetic.
    """
    rows, constants = [stiffness, *values.swapaxes(0, 1)], series.adjoint.constants or series.constants
    found = []
    for k in range(len(rows)):
        moved = [row + 1j * STEP if i == k else row for i, row in enumerate(rows)]
        changes = ((c, x) for c, x in enumerate(constants(moved[0], moved[1:])) if np.iscomplexobj(x))
        found.append(sum((bars[..., c] * x.imag / STEP for c, x in changes), np.zeros_like(stiffness)))
    for row, _ in series.adjoint.fixed:
        found[1 + row] = np.full_like(stiffness, np.nan)
    return found[0], np.stack(found[1:], axis=1)


def damping_gradient(mass, stiffness, ratios, bars):
    """Derivatives by masses, stiffnesses and ratios (p, n) of chains, from `bars` (p, n, n) of M^-1 C.

    As `chain.modal_damping.add_damping_gradient`: (M^-1 C)_ij = S_ij (m_j / m_i)^1/2, S a function of the
    symmetric M^-1/2 K M^-1/2 with its eigenvectors.
    """
    roots = np.sqrt(mass)
    scale = roots[:, None, :] / roots[:, :, None]
    squares, vectors, matrix = modal_squares(mass, stiffness)
    omega, n = np.sqrt(np.maximum(squares, 0.0)), mass.shape[1]
    inner = np.einsum("pir,pij,pjs->prs", vectors, bars * scale, vectors, optimize=True)
    by_ratios = 2.0 * omega * np.einsum("prr->pr", inner)
    sums, change = omega[:, :, None] + omega[:, None, :], omega[:, :, None] - omega[:, None, :]
    all_ratios = np.broadcast_to(ratios, omega.shape)
    slopes = (all_ratios[:, :, None] + all_ratios[:, None, :]) / sums
    difference = all_ratios[:, :, None] - all_ratios[:, None, :]
    slopes += np.divide(difference, change, out=np.zeros_like(change), where=difference != 0.0)
    of_matrix = np.einsum("pir,prs,pjs->pij", vectors, inner * slopes, vectors, optimize=True)
    of_matrix = 0.5 * (of_matrix + of_matrix.swapaxes(1, 2))
    damping = bars * modal_damping(mass, stiffness, ratios)
    by_mass = 0.5 * (damping.sum(axis=1) - damping.sum(axis=2)) / mass
    by_mass -= (of_matrix * matrix).sum(axis=2) / mass
    at = np.arange(n)
    diagonal = of_matrix[:, at, at] / mass
    by_stiffness = diagonal.copy()
    beside = of_matrix[:, at[1:], at[:-1]] / (roots[:, 1:] * roots[:, :-1])
    by_stiffness[:, 1:] += diagonal[:, :-1] - 2.0 * beside
    return by_mass, by_stiffness, by_ratios


class ChainBars(NamedTuple):
    """Bars of the numbers that a march works with, of particles p.

    Attributes
    ----------
    mobility, dashpot : array (p, n)
        By ln(1/m) at given forces of the springs, and by beta k.
    alpha : array (p,)
    constants : array (p, n, constants)
        Of the law.
    damping : array (p, n, n), or (p, 0, 0)
        By M^-1 C of modal ratios.
    """

    mobility: np.ndarray
    dashpot: np.ndarray
    alpha: np.ndarray
    constants: np.ndarray
    damping: np.ndarray


def parameter_gradients(series, parameters, bars):
    """Gradient by the parameters of particles, rows for all of which are given."""
    mass, stiffness, rayleigh, ratios, values = parameters
    by_stiffness, by_law = constants_gradient(series, stiffness, values, bars.constants)
    by_mass, by_ratios = -bars.mobility / mass, np.full(mass.shape, np.nan)
    if bars.damping.size:
        # what masses do to the springs' part of the accelerations, which are less by that of damping
        by_mass += (bars.damping * modal_damping(mass, stiffness, ratios)).sum(axis=2) / mass
        more_mass, more_stiffness, by_ratios = damping_gradient(mass, stiffness, ratios, bars.damping)
        by_mass, by_stiffness = by_mass + more_mass, by_stiffness + more_stiffness
    by_rayleigh = np.stack([bars.alpha, (stiffness * bars.dashpot).sum(axis=1)], axis=1)
    return by_mass, by_stiffness + rayleigh[:, 1:] * bars.dashpot, by_rayleigh, by_ratios, by_law


def add_gradients(kernels, lanes, parameters, members, problem, weights, gradients):
    """Add the gradients of particles, sums where they share a row; return those lost, with neighbours.

    Parameters
    ----------
    kernels : pair of callable
        Compiled: a march, as of `march_population`, and the sweep back.
    lanes, parameters, members, problem
        As of `march_population`.
    weights : array (p, s, q)
        Of the statistics.
    gradients : tuple of array
        In the shapes of the parameters.
    """
    march, sweep = kernels
    ground, wanted, observed = problem
    tape = tape_memory(lanes.series, lanes.n, ground.n_steps, *observed.shape)
    memory = GradientLanes(lanes, len(observed), weights.shape[2])
    lost, done, bars = [], [], []
    for own in groups_of(members):
        chains = rows_of(parameters, np.resize(own, LANES))
        tape.clear()
        spans = lanes.march(march, chains, problem, tape.tape)
        if lanes.lost.any():  # the steps of its neighbours went by it
            lost.append(own)
            continue
        memory.clear(weights[np.resize(own, LANES)])
        step = sweep(lanes.group, memory.memory, tape.tape, spans, wanted, observed)
        bars.append(ChainBars(*(x[: len(own)] for x in memory.take(step))))
        done.append(own)
    tape.keep()
    if done:
        done = np.concatenate(done)
        bars = ChainBars(*map(np.concatenate, zip(*bars, strict=True)))
        found = parameter_gradients(lanes.series, rows_of(parameters, done), bars)
        for total, gradient in zip(gradients, found, strict=True):
            np.add.at(total, done % len(total), gradient)
    return np.concatenate(lost) if lost else members[:0]


@cache
def reverse_of(series):
    """Return the function that carries bars back over all orders of a step."""
    order, others, first = series.order, reverse_from(series, series.order - 1), reverse_from(series, 0)
    add_sums = sums_of(series)

    @jit
    def reverse(address, bars, modal, n, ahead):
        largest = n if modal != 0 else BLOCK
        high = n
        while high > 0:
            size = largest if high > largest else high
            others(address, bars, modal, n, ahead, high, size)
            top = high + order - 1 if high + order - 1 < n else n
            own = size - order + 1 + top - high if size < high else top
            first(address, bars, modal, n, ahead, top, own)
            add_sums(address, bars, modal, n, top, own)
            high -= size

    return reverse


@cache
def branches_of(series):
    """Return the functions that begin the reverse of a step with kinks, and bring back its branches."""
    length, record, entries, constants = layout_of(series)
    _, own, own_entries, _ = layout_of(bars_of(series))
    width = width_of(series)
    rates, zs = (1 + RATE) * length, (1 + Z) * length
    branch = jit(series.branch)

    @jit
    def has_kink(address, i):
        return read_number(address, (i * record + entries + HAS_KINK) * LANES) > 0.0

    @jit
    def spread(address, bars, n):
        """Give the coefficients of springs with kinks the bars that those of others begin with."""
        for i in range(1, n + 1):
            if has_kink(address, i):
                here = i * own
                z = load(bars, here + own_entries + Z_END)
                for k in range(length):
                    store(bars, here + zs + k, z)
                    store(bars, here + rates + k, splat(0.0))

    @jit
    def restore_branches(group, state):
        """Bring back the branches of springs that had kinks."""
        address, n = group.address, group.n
        for i in range(1, n + 1):
            if has_kink(address, i):
                here = i * record
                rate_sign, z_sign = signs_of(load(state, (i - 1) * width + 3))
                store(address, here + entries + RATE_SIGN, rate_sign)
                store(address, here + entries + Z_SIGN, z_sign)
                branch(Spring(address, here + length, length, here + constants), rate_sign * z_sign, z_sign)

    return spread, restore_branches


@cache
def step_adjoint(series):
    """Return functions that carry bars back over a step that is repeated, or over one that is not taken."""
    width, kinks = width_of(series), series.branch is not None
    expand, reverse, add_damping = series_of(series, True), reverse_of(series), damping_bars(series)
    if kinks:
        turn, unturn, apply = turn_of(series), turns_adjoint(series), feedback_of(series)
        unapply = feedback_adjoint(series)
        spread, restore_branches = branches_of(series)

    @jit
    def reverse_step(group, memory, states, slot):
        """Repeat the step that begins in a slot, and carry bars back over it."""
        address, _, modal, n = group
        bars = memory.bars
        if kinks:
            write_number(memory.trace, 0, 0.0)
        state = states + 8 * LANES * (slot * n * width)
        count = expand(group, state, memory.batch, memory.trace)
        if kinks:
            if count > 0:
                turn(memory.batch, count, memory.trace)
            apply(address, modal, n, memory.before)
            unapply(address, bars, (modal, memory.modal), n, memory.before)
            spread(address, bars, n)
            unturn(bars, memory.kinks, memory.trace)
            restore_branches(group, state)
        ahead = states + 8 * LANES * (max(slot - 1, 0) * n * width)
        reverse(address, bars, modal, n, ahead)
        if modal != 0:
            add_damping(address, bars, memory.modal, n)

    @jit
    def reverse_end(group, memory):
        """Carry bars back over the first order of a step behind the end of the march."""
        address, _, modal, n = group
        reverse(address, memory.bars, modal, n, address)
        if modal != 0:
            add_damping(address, memory.bars, memory.modal, n)

    return reverse_step, reverse_end


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
            misfit, weights = load(tape.misfits, at), memory.weights + 8 * LANES * j * count
            bar = splat(0.0)
            if observed[j, sample] == observed[j, sample]:  # NaN is a gap
                bar = share * load(weights, 0) * misfit
            if count > 1:
                change = splat(0.0)
                if sample > 0:
                    change = misfit - load(tape.misfits, at - n_sensors)
                else:
                    bar = bar + load(weights, 2)
                if sample < total - 1:
                    change = change - (load(tape.misfits, at + n_sensors) - misfit)
                else:
                    bar = bar + load(weights, 3)
                bar = bar + share * load(weights, 1) * change
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
                store(memory.bars, (wanted.sensors[j] + 1) * own + c, splat(0.0))

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
            store(memory.bars, at + V_END, inverse * load(memory.bars, at + V_END))
            store(memory.bars, at + DASHPOT, factor * load(memory.bars, at + DASHPOT))
        end = (n + 1) * own + DRAG
        store(memory.bars, end, inverse * load(memory.bars, end))
        if group.modal != 0:
            for i in range(n * n):
                store(memory.modal, i, inverse * load(memory.modal, i))

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
