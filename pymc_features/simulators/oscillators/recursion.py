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
from pymc_features.simulators.oscillators.arguments import interpolate, write_own
from pymc_features.simulators.oscillators.fast_modes import (
    STIFFEST,
    add_following,
    has_fast,
    highest_step,
    is_fast,
)
from pymc_features.simulators.oscillators.table import (
    N_ROWS,
    advance,
    new_outputs,
    scale_input,
    whole_vectors,
    write_table,
)

BLOCK = 128  # output samples handled at a time: the working set stays in the first-level cache


@jit
def modal_damping(omega, rayleigh, ratio):
    """D = 2 zeta omega = alpha + beta omega^2 + 2 ratio omega [1/s] of a mode, Eq. (19)."""
    return rayleigh[0] + rayleigh[1] * omega * omega + 2.0 * ratio * omega


@jit
def write_damping(omega, rayleigh, ratios, step, damping):
    """Write D of all modes (m,); False if one is negative, or too large to be stepped at such a frequency."""
    for r in range(omega.size):
        damping[r] = modal_damping(omega[r], rayleigh, ratios[r])
        if not can_be_damped(omega[r] * step, damping[r] * step):
            return False
    return True


@jit
def can_be_damped(w, d):
    """Whether a mode of omega h and D h has a response; NaN has none.

    One that cannot be stepped must relax within a step, D / omega^2 < h, to follow its input.
    """
    return d >= 0.0 and d < np.inf and (d < STIFFEST or d < w * w)


@jit
def add_feed(feed, own, count, block):
    """Add what inputs (d, >= count) do directly to `count` samples of a block (s, >= count)."""
    for i in range(own.shape[0]):
        for j in range(block.shape[0]):
            share = feed[j, i]
            if share != 0.0:
                for b in range(count):
                    block[j, b] += share * own[i, b]


@jit
def add_shares(shares, excitation, ground, first, count, block):
    """Add what the inputs and their derivatives do directly, by `shares` (k, s, d); else as `add_feed`."""
    own = np.empty((ground.shape[0], count))
    write_own(excitation, ground, first, count, own)
    add_feed(shares[0], own, count, block)
    for k in range(1, shares.shape[0]):
        add_feed(shares[k], excitation.direct[k, :, first : first + count], count, block)


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
    inputs, dt, substeps, stride, _ = excitation
    n_sensors, n_modes = system.shapes.shape
    n_inputs, total = inputs.shape[0], max(history.shape[1], observed.shape[1])
    width = whole_vectors(n_modes)
    tables, states = np.zeros((n_inputs, N_ROWS, width)), np.zeros((n_inputs, 2, width))
    for i in range(n_inputs):
        write_table(system.omega, system.damping, dt / substeps, quantity, tables[i])
        scale_input(tables[i], system.participation[:, i])
    shares, step, highest = np.zeros((1, *feed.shape)), dt / substeps, highest_step(excitation)
    if has_fast(system, step, highest):
        follows = np.empty(n_modes, dtype=np.bool_)
        for r in range(n_modes):
            follows[r] = is_fast(system.omega[r] * step, system.damping[r] * step, highest)
            if follows[r]:
                tables[:, :, r] = 0.0
        shares = np.zeros((max(excitation.direct.shape[0], 1), *feed.shape))
        add_following(system, follows, quantity, shares)
    shares[0] += feed
    ground, block = np.empty((n_inputs, BLOCK * stride + 1)), np.empty((n_sensors, BLOCK))
    outputs = new_outputs(BLOCK, n_modes)
    for first in range(0, total, BLOCK):
        count = min(BLOCK, total - first)
        for i in range(n_inputs):
            interpolate(inputs[i], substeps, first * stride, ground[i])
            advance(tables[i], i == 0, states[i], ground[i], stride, count, outputs)
        np.dot(system.shapes, outputs.T, block)
        add_shares(shares, excitation, ground, first, count, block)
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
