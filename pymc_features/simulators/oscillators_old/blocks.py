"""What becomes of a block of the response: it is stored, or compared with the data."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.linear.arguments import writable
from pymc_features.simulators.oscillators_old.discrepancy import add_increments


@jit
def take_block(block, first, count, observed, history, sums):
    """Keep `count` samples of all outputs, from sample `first` on, or compare them with the data.

    Parameters
    ----------
    block : array (s, >= count)
        Overwritten.
    observed : array (s, u)
        Data; not read if there is a `history`.
    history : array (s, u) or (0, 0)
        Written, unless it is empty.
    sums : array (4, s)
        Otherwise: sums of squares of misfits and of their increments, first and last misfit; updated.
    """
    for j in range(block.shape[0]):
        if history.size:
            for b in range(count):
                history[j, first + b] = block[j, b]
            continue
        squares = 0.0
        for b in range(count):
            misfit = observed[j, first + b] - block[j, b]
            squares += misfit * misfit
            block[j, b] = misfit
        sums[0, j] += squares
        add_increments(block[j], count, first == 0, sums[1:], j)


@jit
def take_change(response, change, first, count, observed, history, sums):
    """Keep `count` samples of the change of the response, or what they do to the discrepancy.

    Parameters
    ----------
    response, change : array (>= count, s)
        The response is read only for comparison.
    observed, history
        As in `take_block`.
    sums : array (s,)
        Change of sum_k (g - y)^2; updated, unless there is a history.
    """
    for j in range(change.shape[1]):
        if history.size:
            for b in range(count):
                history[j, first + b] = change[b, j]
            continue
        total = 0.0
        for b in range(count):
            total += (response[b, j] - observed[j, first + b]) * change[b, j]
        sums[j] += 2.0 * total


def destination(shape, observed):
    """Arrays `observed`, `history` and `sums` of `take_block`: no data, no comparison."""
    if observed is None:
        return np.empty((0, 0)), np.empty(shape), np.zeros((4, 0))
    return writable(observed), np.empty((0, 0)), np.zeros((4, shape[0]))
