"""Misfit r = y - g between data and response: what a gradient by its statistics asks of the response.

The statistics of each sensor are

    e = (1/N) sum_k r_k^2  (Eq. 3),   c = (1/N) sum_k (r_k - r_{k-1})^2,   r_0,   r_{N-1},

of which all likelihoods but those of errors correlated in time need the first only. Where the data are NaN
there is a gap, whose samples add nothing to e; N stays the number of all samples. The other statistics are
NaN then.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.recursion import BLOCK


@jit
def weigh_misfit(response, data, first, weights, misfits, weighted):
    """Write the derivatives of L = sum_j weights_j . statistics_j by the samples of a block of the response.

    An increment joins two samples: column 0 belongs to the last sample of the block before.

    Parameters
    ----------
    response : array (s, BLOCK)
    data : array (s, u)
    first : int
        Sample with which the block begins.
    weights : array (s, 1) or (s, 4)
    misfits : array (s, BLOCK + 1)
        Overwritten; column 0 has the misfit before the block, from the call before this.
    weighted : array (s, BLOCK + 1)
        Written; zero behind the end of the data.
    """
    total = data.shape[1]
    count = min(BLOCK, total - first)
    for j in range(data.shape[0]):
        y, g, w, r = data[j, first : first + count], response[j], weighted[j], misfits[j]
        factor = 2.0 * weights[j, 0] / total
        w[0], w[count + 1 :] = 0.0, 0.0
        for b in range(count):
            w[b + 1] = factor * (g[b] - y[b]) if y[b] == y[b] else 0.0
        if weights.shape[1] == 4:
            for b in range(count):
                r[b + 1] = y[b] - g[b]
            factor = 2.0 * weights[j, 1] / total
            for b in range(1 if first == 0 else 0, count):
                change = factor * (r[b + 1] - r[b])
                w[b] += change
                w[b + 1] -= change
            if first == 0:
                w[1] -= weights[j, 2]
            if first + count == total:
                w[count] -= weights[j, 3]
            r[0] = r[count]


@jit
def weigh_history(response, observed, weights):
    """Overwrite a whole response (s, u) by the derivatives of L by it, see `weigh_misfit`."""
    n_sensors, total = response.shape
    for j in range(n_sensors):
        square_weight = 2.0 * weights[j, 0] / total
        if weights.shape[1] == 1:
            for k in range(total):
                misfit = observed[j, k] - response[j, k]
                response[j, k] = -square_weight * misfit if observed[j, k] == observed[j, k] else 0.0
            continue
        increment_weight = 2.0 * weights[j, 1] / total
        misfit, increment = observed[j, 0] - response[j, 0], 0.0
        for k in range(total):
            following = observed[j, k + 1] - response[j, k + 1] if k + 1 < total else misfit
            response[j, k] = -square_weight * misfit - increment_weight * (increment - (following - misfit))
            misfit, increment = following, following - misfit
        response[j, 0] -= weights[j, 2]
        response[j, total - 1] -= weights[j, 3]


@jit
def copy_block(history, first, weighted):
    """Copy a block of a history (s, u) into columns 1 ... of `weighted` (s, BLOCK + 1), zero behind it."""
    count = min(BLOCK, history.shape[1] - first)
    for j in range(history.shape[0]):
        weighted[j, 0], weighted[j, count + 1 :] = 0.0, 0.0
        for b in range(count):
            weighted[j, b + 1] = history[j, first + b]


@jit
def take_change(response, change, first, observed, history, sums):
    """Store a block of the change of the response, or what it does to the sums of squares.

    Parameters
    ----------
    response, change : array (s, BLOCK)
        The response is not read if there is a `history`.
    first : int
        Sample with which the block begins.
    observed, history
        As in `recursion.take_block`.
    sums : array (s,)
        Change of sum_k r_k^2; updated, unless there is a history.
    """
    count = min(BLOCK, max(history.shape[1], observed.shape[1]) - first)
    for j in range(change.shape[0]):
        if history.size:
            for b in range(count):
                history[j, first + b] = change[j, b]
            continue
        total = 0.0
        for b in range(count):
            total += (response[j, b] - observed[j, first + b]) * change[j, b]
        if total != total:
            total = measured_product(response[j], observed[j, first : first + count], change[j])
        sums[j] += 2.0 * total


@jit
def measured_product(response, data, change):
    """Sum of (response - data) change over the samples that were measured."""
    total = 0.0
    for b in range(data.size):
        if data[b] == data[b]:
            total += (response[b] - data[b]) * change[b]
    return total


def measured_difference(response, observed) -> np.ndarray:
    """Response less data, of any shape; zero where nothing was measured."""
    return np.where(np.isnan(observed), 0.0, response - observed)
