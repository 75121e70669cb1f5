"""The recursion and the comparison with data for one structure in each lane of a vector register.

The recursion of `recursion.py` in coordinates made for speed. For mode r, z = (z1, z2) is the state turned
and scaled so that z1 is the mode's output, Eq. (24), and z2 its complement in energy; the turned equations
are z[k+1] = A z[k] + b0 a[k] + b1 a[k+1]. With y = z - b1 a,

    y[k+1] = A y[k] + (A b1 + b0) a[k],     output[k] = y1[k] + b1_1 a[k],

and with y2 scaled so that the coefficient by which it enters y1 is one, five products for a mode and step
instead of ten; what stands before a[k] in the output goes into the feed-through of the sensors. A block of
16 outputs of all modes stays in the first-level cache, where it is combined with the mode shapes and
compared with the data, two sensors and four samples at a time. Where the increments of the misfit are asked
for, the misfits of the block go through a buffer in that cache; where not, Numba leaves that code out. Blocks
with gaps in the data are compared by a plain loop.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, load, splat, store
from pymc_features.simulators.oscillators.arguments import interpolate, single_input
from pymc_features.simulators.oscillators.gaps import add_measured_squares, is_whole
from pymc_features.simulators.oscillators.lanes import N_COEFFICIENTS, N_OF_PAIR, SAMPLES, clear, copy_data
from pymc_features.simulators.oscillators.recursion import (
    N_ROWS,
    OUT_P,
    OUT_Q,
    P_NEXT,
    P_NOW,
    P_P,
    P_Q,
    Q_NEXT,
    Q_NOW,
    Q_P,
    Q_Q,
    W,
    write_table,
)


@jit
def fill_lane(lanes, lane, table, system, feed, start):
    """Write one structure under one input into a lane.

    Parameters
    ----------
    table : array (11, m)
        From `recursion.write_table`.
    system : ModalSystem
    feed : array (s,)
        Feed-through; overwritten.
    start : float
        First sample of the ground acceleration [m/s^2].
    """
    even_modes = lanes.states.shape[0] // 2
    for r in range(table.shape[1]):
        after = turn_to_output(table, r, start, lanes.coefficients, lanes.states, lane)
        for j in range(feed.size):
            shape = system.shapes[j, r] * system.participation[r, 0]
            feed[j] += shape * after
            lanes.shapes[j * even_modes + r, lane] = shape
    for j in range(feed.size):
        lanes.feed[j, lane] = feed[j]


@jit
def turn_to_output(table, r, start, coefficients, states, lane):
    """Write coefficients and initial state of one mode; return what stands before a[k] in its output."""
    transition = table[Q_Q, r], table[Q_P, r], table[P_Q, r], table[P_P, r]
    hold = *transition, table[Q_NOW, r], table[P_NOW, r], table[Q_NEXT, r], table[P_NEXT, r]
    step, after, after_2 = turned(hold, table[W, r], table[OUT_Q, r], table[OUT_P, r])
    for i in range(N_COEFFICIENTS):
        coefficients[N_COEFFICIENTS * r + i, lane] = step[i]
    states[2 * r, lane] = 0.0 - after * start
    states[2 * r + 1, lane] = 0.0 - after_2 * start
    return after


@jit
def turned(hold, w, output_q, output_p):
    """The recursion of y, of one mode or one in each lane: its five coefficients, b1_1 and scaled b1_2."""
    qq, qp, pq, pp, now_q, now_p, next_q, next_p = hold
    out, cross = output_q / w, output_p  # output of the state (w q, p)
    norm = out * out + cross * cross
    qp, pq, now_q, next_q = qp * w, pq / w, now_q * w, next_q * w
    # rows of the turned transition T E, then times T' / norm, with T = [[out, cross], [-cross, out]]
    top_q, top_p = out * qq + cross * pq, out * qp + cross * pp
    low_q, low_p = out * pq - cross * qq, out * pp - cross * qp
    a11, a12 = (top_q * out + top_p * cross) / norm, (top_p * out - top_q * cross) / norm
    a21, a22 = (low_q * out + low_p * cross) / norm, (low_p * out - low_q * cross) / norm
    after_1, after_2 = out * next_q + cross * next_p, out * next_p - cross * next_q
    input_1 = a11 * after_1 + a12 * after_2 + out * now_q + cross * now_p
    input_2 = a21 * after_1 + a22 * after_2 + out * now_p - cross * now_q
    return (a11, input_1, a12 * a21, a22, a12 * input_2), after_1, a12 * after_2


@jit
def advance_lanes(coefficients, states, ground, first, stride, outputs):
    """Write `SAMPLES` outputs of every mode into `outputs` (m SAMPLES, LANES) and carry the states on.

    `ground` has the ground acceleration at the steps of the recursion, from entry `first` on. Two modes go
    together, so that one does not wait for the other; an even number of modes.
    """
    for r in range(0, states.shape[0] // 2, 2):
        row = N_COEFFICIENTS * r
        a11, b1 = load(coefficients, row), load(coefficients, row + 1)
        a21, a22, b2 = load(coefficients, row + 2), load(coefficients, row + 3), load(coefficients, row + 4)
        c11, d1 = load(coefficients, row + 5), load(coefficients, row + 6)
        c21, c22, d2 = load(coefficients, row + 7), load(coefficients, row + 8), load(coefficients, row + 9)
        y1, y2 = load(states, 2 * r), load(states, 2 * r + 1)
        z1, z2 = load(states, 2 * r + 2), load(states, 2 * r + 3)
        for sample in range(SAMPLES):
            store(outputs, SAMPLES * r + sample, y1)
            store(outputs, SAMPLES * (r + 1) + sample, z1)
            for step in range(first + sample * stride, first + (sample + 1) * stride):
                a = splat(ground[step])
                y1, y2 = a11 * y1 + (y2 + b1 * a), a21 * y1 + (a22 * y2 + b2 * a)
                z1, z2 = c11 * z1 + (z2 + d1 * a), c21 * z1 + (c22 * z2 + d2 * a)
        store(states, 2 * r, y1)
        store(states, 2 * r + 1, y2)
        store(states, 2 * r + 2, z1)
        store(states, 2 * r + 3, z2)


@jit
def advance_pairs(coefficients, states, ground, first, stride, outputs):
    """As `advance_lanes`, of modes of which both states are outputs (2 m SAMPLES, LANES)."""
    for r in range(0, states.shape[0] // 2, 2):
        row = N_OF_PAIR * r
        a11, a12, b1 = load(coefficients, row), load(coefficients, row + 1), load(coefficients, row + 2)
        a21, a22, b2 = load(coefficients, row + 3), load(coefficients, row + 4), load(coefficients, row + 5)
        c11, c12, d1 = load(coefficients, row + 6), load(coefficients, row + 7), load(coefficients, row + 8)
        c21, c22, d2 = load(coefficients, row + 9), load(coefficients, row + 10), load(coefficients, row + 11)
        y1, y2 = load(states, 2 * r), load(states, 2 * r + 1)
        z1, z2 = load(states, 2 * r + 2), load(states, 2 * r + 3)
        for sample in range(SAMPLES):
            place = 2 * SAMPLES * r + sample
            store(outputs, place, y1)
            store(outputs, place + SAMPLES, y2)
            store(outputs, place + 2 * SAMPLES, z1)
            store(outputs, place + 3 * SAMPLES, z2)
            for step in range(first + sample * stride, first + (sample + 1) * stride):
                a = splat(ground[step])
                y1, y2 = a11 * y1 + (a12 * y2 + b1 * a), a21 * y1 + (a22 * y2 + b2 * a)
                z1, z2 = c11 * z1 + (c12 * z2 + d1 * a), c21 * z1 + (c22 * z2 + d2 * a)
        store(states, 2 * r, y1)
        store(states, 2 * r + 1, y2)
        store(states, 2 * r + 2, z1)
        store(states, 2 * r + 3, z2)


@jit
def add_squares(lanes, data, sample, ground, step, stride, misfits):
    """Add the squared misfits of `SAMPLES` samples to `lanes.squares`.

    `data` (sensors, time) from column `sample` on and `ground` from entry `step` on are common to all lanes.
    The misfits are written into `misfits` (s SAMPLES, LANES), unless it is None.
    """
    shapes, feed, outputs, squares = lanes.shapes, lanes.feed, lanes.outputs, lanes.squares
    n_modes = outputs.shape[0] // SAMPLES
    last = data.shape[0] - 1
    for j in range(0, squares.shape[0], 2):
        k = min(j + 1, last)  # an odd number of sensors is filled up with one of no consequence
        sum_a, sum_b = load(squares, j), load(squares, j + 1)
        feed_a, feed_b = load(feed, j), load(feed, j + 1)
        for t in range(0, SAMPLES, 4):
            g, i = step + t * stride, sample + t
            g0, g1 = splat(ground[g]), splat(ground[g + stride])
            g2, g3 = splat(ground[g + 2 * stride]), splat(ground[g + 3 * stride])
            a0, a1 = splat(data[j, i]) - feed_a * g0, splat(data[j, i + 1]) - feed_a * g1
            a2, a3 = splat(data[j, i + 2]) - feed_a * g2, splat(data[j, i + 3]) - feed_a * g3
            b0, b1 = splat(data[k, i]) - feed_b * g0, splat(data[k, i + 1]) - feed_b * g1
            b2, b3 = splat(data[k, i + 2]) - feed_b * g2, splat(data[k, i + 3]) - feed_b * g3
            for r in range(n_modes):
                shape_a, shape_b = load(shapes, j * n_modes + r), load(shapes, (j + 1) * n_modes + r)
                z0, z1 = load(outputs, SAMPLES * r + t), load(outputs, SAMPLES * r + t + 1)
                z2, z3 = load(outputs, SAMPLES * r + t + 2), load(outputs, SAMPLES * r + t + 3)
                a0, b0 = a0 - shape_a * z0, b0 - shape_b * z0
                a1, b1 = a1 - shape_a * z1, b1 - shape_b * z1
                a2, b2 = a2 - shape_a * z2, b2 - shape_b * z2
                a3, b3 = a3 - shape_a * z3, b3 - shape_b * z3
            sum_a = sum_a + ((a0 * a0 + a1 * a1) + (a2 * a2 + a3 * a3))
            sum_b = sum_b + ((b0 * b0 + b1 * b1) + (b2 * b2 + b3 * b3))
            if misfits is not None:
                row_a, row_b = SAMPLES * j + t, SAMPLES * (j + 1) + t
                store(misfits, row_a, a0)
                store(misfits, row_a + 1, a1)
                store(misfits, row_a + 2, a2)
                store(misfits, row_a + 3, a3)
                store(misfits, row_b, b0)
                store(misfits, row_b + 1, b1)
                store(misfits, row_b + 2, b2)
                store(misfits, row_b + 3, b3)
        store(squares, j, sum_a)
        store(squares, j + 1, sum_b)


@jit
def add_increments(increments, count, is_first):
    """Add the squared increments of `count` samples of a block, and keep the first and last misfit."""
    misfits, squares, first, last = increments
    for j in range(squares.shape[0]):
        row = SAMPLES * j
        if is_first:
            store(first, j, load(misfits, row))
            store(last, j, load(misfits, row))
        total, before = load(squares, j), load(last, j)
        for b in range(count):
            now = load(misfits, row + b)
            step = now - before
            total = total + step * step
            before = now
        store(squares, j, total)
        store(last, j, before)


@jit
def march(lanes, excitation, observed, increments):
    """Sums of squares of all sensors for the structures in the lanes, into `lanes.squares`.

    `increments` is None if they are not asked for; with them, all sums of data with gaps are NaN.
    """
    acceleration, _, substeps, stride = excitation
    own_ground, outputs = lanes.ground, lanes.outputs
    n_times = observed.shape[1]
    lanes.squares.fill(0.0)
    if increments is not None:
        increments.squares.fill(0.0)
    for first in range(0, n_times, SAMPLES):
        step, sample = first * stride, first
        ground, data = acceleration, observed
        if substeps > 1 or step + own_ground.size > acceleration.size:
            interpolate(acceleration, substeps, step, own_ground)
            ground, step = own_ground, 0
        count = n_times - first
        if count < SAMPLES:  # the end of the data: what lies behind it must come out as zero
            for k in range(count * stride, own_ground.size):
                own_ground[k] = 0.0
        if count < SAMPLES:
            copy_data(lanes, observed, first, count)
            data, sample = lanes.data, 0
        if outputs.shape[0] == SAMPLES * lanes.states.shape[0]:
            advance_pairs(lanes.coefficients, lanes.states, ground, step, stride, outputs)
        else:
            advance_lanes(lanes.coefficients, lanes.states, ground, step, stride, outputs)
        for r in range(outputs.shape[0] // SAMPLES):
            for b in range(count, SAMPLES):
                store(outputs, SAMPLES * r + b, splat(0.0))
        if increments is None:
            if lanes.has_gaps and not is_whole(observed, first, min(count, SAMPLES)):
                add_measured_squares(lanes, observed, first, min(count, SAMPLES), ground, step, stride)
            else:
                add_squares(lanes, data, sample, ground, step, stride, None)
        else:
            add_squares(lanes, data, sample, ground, step, stride, increments.misfits)
            add_increments(increments, min(count, SAMPLES), first == 0)


@jit
def lane_statistics(lanes, excitation, observed, increments):
    """Statistics (LANES, s, 1 or 4) of the misfit of the structures in the lanes, which are then taken out.

    Parameters
    ----------
    excitation : Excitation
        One input, (t,) or (1, t).
    observed : array (s, u)
        Data.
    increments : Increments or None
        None if only e_j is asked for.
    """
    march(lanes, single_input(excitation), observed, increments)
    n_sensors, n_times = observed.shape
    result = np.empty((LANES, n_sensors, 1 if increments is None else 4))
    for lane in range(LANES):
        for j in range(n_sensors):
            result[lane, j, 0] = lanes.squares[j, lane] / n_times
            if increments is not None:
                result[lane, j, 1] = increments.squares[j, lane] / n_times
                result[lane, j, 2] = increments.first[j, lane]
                result[lane, j, 3] = increments.last[j, lane]
    clear(lanes)
    return result


@jit
def put_system(lanes, lane, system, feed, excitation, quantity):
    """Write a `ModalSystem` under one input into a lane; `feed` (s,) is overwritten."""
    table = np.empty((N_ROWS, system.omega.size))
    write_table(system.omega, system.damping, excitation.dt / excitation.substeps, quantity, table)
    fill_lane(lanes, lane, table, system, feed, single_input(excitation).acceleration[0])
