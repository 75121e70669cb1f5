"""Misfit r = y - g between data and response: its statistics, and what their gradient asks of the response.

The statistics of each sensor are

    e = (1/N) sum_k r_k^2  (Eq. 3),   c = (1/N) sum_k (r_k - r_{k-1})^2,   r_0,   r_{N-1},

of which all likelihoods but those of errors correlated in time need the first only.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.recursion import BLOCK


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
            history[j, first : first + count] = block[j, :count]
    else:
        compare_block(block, first, count, observed, sums)


@jit
def compare_block(block, first, count, observed, sums):
    """Add `count` samples, from sample `first` on, to the sums of squares.

    Parameters
    ----------
    block : array (s, >= count)
        Response; overwritten by the misfit if the increments are asked for.
    observed : array (s, u)
    sums : array (1, s) or (4, s)
        Sums of squares of the misfit and, in four rows, of its increments, first and last misfit; updated.
    """
    for j in range(observed.shape[0]):
        data = observed[j, first : first + count]
        squares = 0.0
        for b in range(count):
            r = data[b] - block[j, b]
            squares += r * r
        sums[0, j] += squares
        if sums.shape[0] == 4:
            for b in range(count):
                block[j, b] = data[b] - block[j, b]
            add_increments(block[j], count, first == 0, sums[1:], j)


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


@jit
def weigh_misfit(response, data, first, weights, misfits, weighted):
    """Write the derivatives of L = sum_j weights_j . statistics_j by the samples of a block of the response.

    An increment joins two samples: row 0 of what is written belongs to the last sample of the block before.

    Parameters
    ----------
    response : array (BLOCK, s)
    data : array (s, u)
    first : int
        Sample with which the block begins.
    weights : array (s, 1) or (s, 4)
    misfits : array (BLOCK + 1, s)
        Overwritten; row 0 has the misfit before the block, from the call before this.
    weighted : array (BLOCK + 1, s)
        Written; zero behind the end of the data.
    """
    total = data.shape[1]
    count = min(BLOCK, total - first)
    weighted[0], weighted[count + 1 :] = 0.0, 0.0
    for j in range(data.shape[0]):
        factor = 2.0 * weights[j, 0] / total
        for b in range(count):
            misfits[b + 1, j] = data[j, first + b] - response[b, j]
            weighted[b + 1, j] = -factor * misfits[b + 1, j]
    if weights.shape[1] == 4:
        for j in range(data.shape[0]):
            factor = 2.0 * weights[j, 1] / total
            for b in range(1 if first == 0 else 0, count):
                change = factor * (misfits[b + 1, j] - misfits[b, j])
                weighted[b, j] += change
                weighted[b + 1, j] -= change
            if first == 0:
                weighted[1, j] -= weights[j, 2]
            if first + count == total:
                weighted[count, j] -= weights[j, 3]
    misfits[0] = misfits[count]


@jit
def weigh_history(response, observed, weights):
    """Overwrite a whole response (s, u) by the derivatives of L by it, see `weigh_misfit`."""
    n_sensors, total = response.shape
    for j in range(n_sensors):
        by_square, by_increment = 2.0 * weights[j, 0] / total, 0.0
        if weights.shape[1] == 4:
            by_increment = 2.0 * weights[j, 1] / total
        misfit, increment = observed[j, 0] - response[j, 0], 0.0
        for k in range(total):
            following = observed[j, k + 1] - response[j, k + 1] if k + 1 < total else misfit
            response[j, k] = -by_square * misfit - by_increment * (increment - (following - misfit))
            misfit, increment = following, following - misfit
        if weights.shape[1] == 4:
            response[j, 0] -= weights[j, 2]
            response[j, total - 1] -= weights[j, 3]


@jit
def copy_block(history, first, weighted):
    """Copy a block of a history (s, u) into rows 1 ... of `weighted` (BLOCK + 1, s), zero behind its end."""
    count = min(BLOCK, history.shape[1] - first)
    weighted[0], weighted[count + 1 :] = 0.0, 0.0
    for j in range(history.shape[0]):
        for b in range(count):
            weighted[b + 1, j] = history[j, first + b]


@jit
def take_change(response, change, first, observed, history, sums):
    """Store a block of the change of the response, or what it does to the sums of squares.

    Parameters
    ----------
    response, change : array (>= count, s)
        The response is not read if there is a `history`.
    first : int
        Sample with which the block begins.
    observed, history
        As in `take_block`.
    sums : array (s,)
        Change of sum_k r_k^2; updated, unless there is a history.
    """
    count = min(change.shape[0], max(history.shape[1], observed.shape[1]) - first)
    for j in range(change.shape[1]):
        total = 0.0
        for b in range(count):
            if history.size:
                history[j, first + b] = change[b, j]
            else:
                total += (response[b, j] - observed[j, first + b]) * change[b, j]
        sums[j] += 2.0 * total
