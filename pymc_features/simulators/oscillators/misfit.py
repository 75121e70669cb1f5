"""Misfit r = y - g between data and response: what a gradient by its statistics asks of the response.

The statistics of each sensor are

    e = (1/N) sum_k r_k^2  (Eq. 3),   c = (1/N) sum_k (r_k - r_{k-1})^2,   r_0,   r_{N-1},

of which all likelihoods but those of errors correlated in time need the first only.
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.recursion import BLOCK


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
