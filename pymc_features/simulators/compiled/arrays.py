"""Arrays as compiled code takes them, and the order of their entries."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit


def writable(array, dtype=np.float64) -> np.ndarray:
    """The array, or a copy if it is read-only or strided: one compiled kernel serves all."""
    if isinstance(array, np.ndarray) and array.dtype == dtype and array.flags.carray:
        return array  # which `require` takes ten times as long to find out
    return np.require(array, dtype, ["C", "W"])


@jit
def copy_entries(source, target):
    """Copy a vector into another one.

    `target[:] = source` would do in NumPy; Numba then compiles the message about two shapes that differ, with
    all its strings, which takes 3 to 5 s.
    """
    for i in range(target.size):
        target[i] = source[i]


@jit
def ascending(values):
    """Positions of numbers in ascending order, by insertion: fast for numbers that are nearly in order."""
    order = np.arange(values.size)
    for i in range(1, values.size):
        here, k = order[i], i
        while k > 0 and values[order[k - 1]] > values[here]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = here
    return order


@jit
def positions(values, lane, order):
    """Write the positions (n,) of the numbers of a lane in ascending order."""
    for i in range(order.size):
        value, k = values[i, lane], i
        while k > 0 and values[order[k - 1], lane] > value:
            order[k] = order[k - 1]
            k -= 1
        order[k] = i
