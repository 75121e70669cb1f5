"""The recursion and the comparison with data for one structure in each lane of a vector register.

The recursion of `recursion.py` in coordinates made for speed. For mode r, z = (z1, z2) is the state turned
and scaled so that z1 is the mode's output, Eq. (24), and z2 its complement in energy; the turned equations
are z[k+1] = A z[k] + b0 a[k] + b1 a[k+1]. With y = z - b1 a,

    y[k+1] = A y[k] + (A b1 + b0) a[k],     output[k] = y1[k] + b1_1 a[k],

and with y2 scaled so that the coefficient by which it enters y1 is one, five products for a mode and step
instead of ten; what stands before a[k] in the output goes into the feed-through of the sensors. The record
goes through in blocks of 16 samples, `blocks`. Where the increments of the misfit are asked for, or data are
missing in a block, its misfits are kept.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, load, store
from pymc_features.simulators.oscillators.blocks import march_block
from pymc_features.simulators.oscillators.lanes import N_COEFFICIENTS, SAMPLES, clear
from pymc_features.simulators.oscillators.places import (
    block_of,
    copy_block,
    has_own_data,
    has_own_ground,
    places_of,
    source_of,
)
from pymc_features.simulators.oscillators.table import (
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
        From `table.write_table`.
    system : ModalSystem
    feed : array (s,)
        Feed-through; overwritten.
    start : float
        First sample of the ground acceleration [m/s^2].
    """
    even_modes = lanes.states.shape[0] // 2
    for j in range(feed.size):
        lanes.direct[j, lane] = feed[j]
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
def is_whole(observed, first, count):
    """Whether a block of data (sensors, time) has no gap."""
    for j in range(observed.shape[0]):
        for k in range(first, first + count):
            if observed[j, k] != observed[j, k]:
                return False
    return True


@jit
def add_measured_squares(lanes, observed, first, count):
    """Add the squared misfits of those of `count` samples, from `first` on, that were measured."""
    for j in range(observed.shape[0]):
        total = load(lanes.squares, j)
        for t in range(count):
            if observed[j, first + t] == observed[j, first + t]:
                misfit = load(lanes.misfits, SAMPLES * j + t)
                total = total + misfit * misfit
        store(lanes.squares, j, total)


@jit
def add_increments(lanes, increments, count, is_first):
    """Add squares of `count` misfits of a block and of their increments; keep the first and last misfit."""
    misfits = lanes.misfits
    for j in range(increments.squares.shape[0]):
        row = SAMPLES * j
        if is_first:
            store(increments.first, j, load(misfits, row))
            store(increments.last, j, load(misfits, row))
        whole, total, before = load(lanes.squares, j), load(increments.squares, j), load(increments.last, j)
        for b in range(count):
            now = load(misfits, row + b)
            step = now - before
            whole, total = whole + now * now, total + step * step
            before = now
        store(lanes.squares, j, whole)
        store(increments.squares, j, total)
        store(increments.last, j, before)


@jit
def march(lanes, excitation, observed, increments):
    """Sums of squares of all sensors for the structures in the lanes, into `lanes.squares`.

    `increments` is None if they are not asked for; with them, all sums of data with gaps are NaN.
    """
    at, source, n_times = places_of(lanes), source_of(lanes, excitation, observed), observed.shape[1]
    lanes.squares.fill(0.0)
    if increments is not None:
        increments.squares.fill(0.0)
    for first in range(0, n_times, SAMPLES):
        count = min(SAMPLES, n_times - first)
        if has_own_ground(source, first) or has_own_data(source, first):  # asked here: a third faster
            copy_block(lanes, source, excitation, observed, first)
        block = block_of(source, first)
        if increments is not None:
            march_block(at, block, True)
            add_increments(lanes, increments, count, first == 0)
        elif count < SAMPLES or (lanes.has_gaps and not is_whole(observed, first, count)):
            march_block(at, block, True)
            add_measured_squares(lanes, observed, first, count)
        else:
            march_block(at, block, False)


@jit
def lane_statistics(lanes, excitation, observed, increments):
    """Statistics (LANES, s, 1 or 4) of the misfit of the structures in the lanes, which are then taken out.

    Parameters
    ----------
    excitation : Excitation
        One input with a sample at each step, see `at_every_step`.
    observed : array (s, u)
        Data.
    increments : Increments or None
        None if only e_j is asked for.
    """
    march(lanes, excitation, observed, increments)
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
def put_system(lanes, lane, system, feed, motion, quantity):
    """Write a `ModalSystem` under a motion as of `at_every_step` into a lane; `feed` (s,) is overwritten."""
    table = np.empty((N_ROWS, system.omega.size))
    write_table(system.omega, system.damping, motion.dt, quantity, table)
    fill_lane(lanes, lane, table, system, feed, motion.acceleration[0])
