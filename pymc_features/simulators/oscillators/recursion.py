"""Damping of modes, and responses of any road compared with data, a block at a time."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.fast_modes import (
    STIFFEST,
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
