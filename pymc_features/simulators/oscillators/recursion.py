"""Exact modal response to an excitation that is linear between its samples, stored or compared with data.

Mode r of Eqs. (20)-(22), per unit participation, obeys q" + D q' + omega^2 q = -a_g(t), D = 2 zeta omega.
In the state x = (q, h q') / h^2 with the step h, and with a_g linear over the step, the exact
solution (first-order hold) is

    x[k+1] = phi0(F) x[k] - (phi1(F) - phi2(F)) e2 a[k] - phi2(F) e2 a[k+1],
    F = [[0, 1], [-s, -d]],   s = (omega h)^2,   d = D h,   e2 = (0, 1),

with phi0 = exp, phi1(z) = (e^z - 1)/z, phi2(z) = (e^z - 1 - z)/z^2, from `hold`.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import (
    RELATIVE_DISPLACEMENT,
    RELATIVE_VELOCITY,
    interpolate,
)
from pymc_features.simulators.oscillators.hold import first_order_hold

BLOCK = 128  # output samples handled at a time: the working set stays in the first-level cache
STIFFEST = 1e6  # omega h and D h of a mode that can be stepped

SMALLEST = 1e-100  # replaces omega h = 0: its square is lost beside anything else

# Rows of the recursion table: state transition, excitation at both ends of the step, output, omega h
Q_Q, Q_P, P_Q, P_P, Q_NOW, P_NOW, Q_NEXT, P_NEXT, OUT_Q, OUT_P, W = range(11)
N_ROWS = 11


@jit
def modal_damping(omega, rayleigh, ratio):
    """D = 2 zeta omega = alpha + beta omega^2 + 2 ratio omega [1/s] of a mode, Eq. (19)."""
    return rayleigh[0] + rayleigh[1] * omega * omega + 2.0 * ratio * omega


@jit
def write_damping(omega, rayleigh, ratios, step, damping):
    """Write D of all modes (m,); False if one is negative, or too stiff to be stepped."""
    for r in range(omega.size):
        damping[r] = modal_damping(omega[r], rayleigh, ratios[r])
        if not (damping[r] >= 0.0 and max(omega[r], damping[r]) * step < STIFFEST):  # NaN too
            return False
    return True


@jit
def write_table(omega, damping, step, quantity, table):
    """Write the recursion and the output of each mode, Eq. (24), from its state (q, q').

    Parameters
    ----------
    omega, damping : array (m,)
        [rad/s] and D [1/s], not negative.
    step : float
        Of the recursion [s].
    quantity : int
        Position in `QUANTITIES`.
    table : array (11, m)
    """
    for r in range(omega.size):
        w, d = max(omega[r] * step, SMALLEST), damping[r] * step
        hold = first_order_hold(w * w, d)
        for i in range(8):
            table[i, r] = hold[i]
        if quantity == RELATIVE_DISPLACEMENT:
            table[OUT_Q, r], table[OUT_P, r] = step * step, 0.0
        elif quantity == RELATIVE_VELOCITY:
            table[OUT_Q, r], table[OUT_P, r] = 0.0, step
        else:
            table[OUT_Q, r], table[OUT_P, r] = -w * w, -d
        table[W, r] = w


@jit
def scale_input(table, participation):
    """Multiply the excitation of a recursion table (11, m) by Gamma (m,) of an input."""
    for row in range(Q_NOW, P_NEXT + 1):
        for r in range(participation.size):
            table[row, r] *= participation[r]


@jit
def advance(table, is_first, q, p, ground, stride, count, outputs):
    """Write `count` outputs of every mode, or add them, and carry the states to the sample behind them.

    Parameters
    ----------
    table : array (11, m)
        From `write_table`, after `scale_input`.
    is_first : bool
        Whether the outputs are written; those of other inputs are added.
    q, p : array (m,)
        Modal states at the first of these samples, at rest at the beginning; overwritten.
    ground : array (> count stride,)
        Excitation at the steps of the recursion.
    stride : int
        Every `stride`-th state is an output.
    outputs : array (>= count, m)
        Updated.
    """
    for b in range(count):
        if is_first:
            for r in range(q.size):
                outputs[b, r] = table[OUT_Q, r] * q[r] + table[OUT_P, r] * p[r]
        else:
            for r in range(q.size):
                outputs[b, r] += table[OUT_Q, r] * q[r] + table[OUT_P, r] * p[r]
        for step in range(b * stride, (b + 1) * stride):
            now, after = ground[step], ground[step + 1]
            for r in range(q.size):
                q_r = (
                    table[Q_Q, r] * q[r]
                    + table[Q_P, r] * p[r]
                    + (table[Q_NOW, r] * now + table[Q_NEXT, r] * after)
                )
                p[r] = (
                    table[P_Q, r] * q[r]
                    + table[P_P, r] * p[r]
                    + (table[P_NOW, r] * now + table[P_NEXT, r] * after)
                )
                q[r] = q_r


@jit
def add_feed(feed, ground, stride, count, block):
    """Add what the inputs do to the response directly, to `count` samples of a block (s, >= count)."""
    at_samples = np.empty(count)
    for i in range(ground.shape[0]):
        for b in range(count):
            at_samples[b] = ground[i, b * stride]
        for j in range(block.shape[0]):
            share = feed[j, i]
            if share != 0.0:
                for b in range(count):
                    block[j, b] += share * at_samples[b]


@jit
def march_modes(system, feed, excitation, quantity, observed, history, sums):
    """Store the response of uncoupled modes, or compare it with data.

    Parameters
    ----------
    system : ModalSystem
    feed : array (s, d)
        What stands before the inputs in the response, see `feed_through`.
    excitation : Excitation
        Of d inputs (d, t), whose responses add up.
    quantity : int
        Position in `QUANTITIES`.
    observed, history, sums
        See `take_block`.
    """
    inputs, dt, substeps, stride = excitation
    n_sensors, n_modes = system.shapes.shape
    n_inputs, total = inputs.shape[0], max(history.shape[1], observed.shape[1])
    tables = np.empty((n_inputs, N_ROWS, n_modes))
    for i in range(n_inputs):
        write_table(system.omega, system.damping, dt / substeps, quantity, tables[i])
        scale_input(tables[i], system.participation[:, i])
    ground, outputs = np.empty((n_inputs, BLOCK * stride + 1)), np.zeros((BLOCK, n_modes))
    q, p, block = np.zeros((n_inputs, n_modes)), np.zeros((n_inputs, n_modes)), np.empty((n_sensors, BLOCK))
    for first in range(0, total, BLOCK):
        count = min(BLOCK, total - first)
        for i in range(n_inputs):
            interpolate(inputs[i], substeps, first * stride, ground[i])
            advance(tables[i], i == 0, q[i], p[i], ground[i], stride, count, outputs)
        np.dot(system.shapes, outputs.T, block)
        add_feed(feed, ground, stride, count, block)
        take_block(block, first, count, observed, history, sums)


@jit
def take_block(block, first, count, observed, history, sums):
    """Store `count` samples of the response, from sample `first` on, or compare them with the data.

    Parameters
    ----------
    block : array (s, >= count)
    observed : array (s, u)
        Data; not read if there is a `history`.
    history : array (s, u) or (0, 0)
        Written, unless it is empty.
    sums : array (1, s) or (4, s)
        Otherwise, see `compare_block`; updated.
    """
    if history.size:
        for j in range(history.shape[0]):
            for b in range(count):
                history[j, first + b] = block[j, b]
    else:
        compare_block(block, first, count, observed, sums)


@jit
def compare_block(block, first, count, observed, sums):
    """Add `count` samples, from sample `first` on, to the sums of squares.

    Where the data are NaN there is a gap: its samples add nothing to the first sum, and the sum of increments
    is NaN.

    Parameters
    ----------
    block : array (s, >= count)
        Response; overwritten by the misfit if the increments are asked for.
    observed : array (s, u)
        Data; NaN where there are none.
    sums : array (1, s) or (4, s)
        Sums of squares of the misfit and, in four rows, of its increments, first and last misfit; updated.
    """
    for j in range(observed.shape[0]):
        data = observed[j, first : first + count]
        squares = 0.0
        for b in range(count):
            r = data[b] - block[j, b]
            squares += r * r
        if squares != squares:
            squares = measured_squares(data, block[j])
        sums[0, j] += squares
        if sums.shape[0] == 4:
            for b in range(count):
                block[j, b] = data[b] - block[j, b]
            add_increments(block[j], count, first == 0, sums[1:], j)


@jit
def measured_squares(data, response):
    """Sum of the squared misfits of the samples that were measured; NaN where their response is."""
    squares = 0.0
    for b in range(data.size):
        if data[b] == data[b]:
            squares += (data[b] - response[b]) ** 2
    return squares


@jit
def add_increments(misfits, count, is_first, sums, j):
    """Add the squared increments of `count` misfits of sensor j; keep its first misfit and its last one."""
    if is_first:
        sums[0, j], sums[1, j], sums[2, j] = 0.0, misfits[0], misfits[0]
    squares = (misfits[0] - sums[2, j]) ** 2
    for b in range(1, count):
        step = misfits[b] - misfits[b - 1]
        squares += step * step
    sums[0, j] += squares
    sums[2, j] = misfits[count - 1]


@jit
def statistics(sums, n_times):
    """Statistics (s, q) of sums (q, s) over a record."""
    result = np.empty((sums.shape[1], sums.shape[0]))
    for j in range(sums.shape[1]):
        for i in range(sums.shape[0]):
            result[j, i] = sums[i, j] / n_times if i < 2 else sums[i, j]
    return result
