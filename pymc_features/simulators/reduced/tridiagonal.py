"""The lowest eigenvalues of a symmetric tridiagonal matrix, one in each vector lane, and their vectors."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, load, magnitude, splat, store, where_less
from pymc_features.simulators.eigen.tridiagonal import twisted_vector

SWEEPS = 60  # halvings of the interval of all eigenvalues; fewer where it is down to rounding before


@jit
def lowest_pairs(diagonal, beside, count):
    """Lowest eigenvalues, ascending, by bisection (Sturm sequences), and vectors of unit length.

    Parameters
    ----------
    diagonal, beside : array (n,)
        Of the matrix T; entry n - 1 of `beside` is not read.
    count : int

    Returns
    -------
    values : array (count,)
        Right to rounding of the largest of all.
    vectors : array (count, n)
        Rows; not orthogonal where eigenvalues are close.
    """
    n, groups = diagonal.size, (count + LANES - 1) // LANES
    least, most = np.inf, -np.inf
    for i in range(n):
        reach = (abs(beside[i - 1]) if i else 0.0) + (abs(beside[i]) if i + 1 < n else 0.0)
        least, most = min(least, diagonal[i] - reach), max(most, diagonal[i] + reach)
    rounding = 1e-16 * max(abs(least), abs(most))
    low, high = np.full((groups, LANES), least - rounding), np.full((groups, LANES), most + rounding)
    wanted = np.arange(groups * LANES).reshape((groups, LANES)) + 0.5
    bisect(diagonal, beside, wanted, (low, high), rounding)
    values, vectors = np.empty(count), np.empty((count, n))
    on, off, pivots = np.empty((n, LANES)), np.zeros((n, LANES)), np.empty((2 * n, LANES))
    shape, here = np.empty((n, LANES)), np.empty((1, LANES))
    for i in range(n):
        store(on, i, splat(diagonal[i]))
        store(off, i, splat(beside[i] if i + 1 < n else 0.0))
    for g in range(groups):
        middle = 0.5 * (load(low, g) + load(high, g))
        store(here, 0, middle)
        twisted_vector(on, off, middle, pivots, shape)
        for lane in range(min(LANES, count - g * LANES)):
            square = 0.0
            for i in range(n):
                square += shape[i, lane] ** 2
            values[g * LANES + lane] = here[0, lane]
            for i in range(n):
                vectors[g * LANES + lane, i] = shape[i, lane] / np.sqrt(square)
    return values, vectors


@jit
def bisect(diagonal, beside, wanted, interval, rounding):
    """Halve intervals (groups, LANES) about eigenvalues number `wanted` until they are down to rounding."""
    (low, high), groups = interval, wanted.shape[0]
    pivots, below = np.empty((groups, LANES)), np.empty((groups, LANES))
    zero, one, tiny = splat(0.0), splat(1.0), splat(1e-290)
    for _ in range(SWEEPS):
        if high[0, 0] - low[0, 0] <= 2.0 * rounding:
            break
        for g in range(groups):
            store(pivots, g, one)
            store(below, g, zero)
        square = 0.0
        for i in range(diagonal.size):
            for g in range(groups):
                middle = 0.5 * (load(low, g) + load(high, g))
                pivot = splat(diagonal[i]) - middle - square / load(pivots, g)
                pivot = where_less(magnitude(pivot), tiny, zero - tiny, pivot)
                store(pivots, g, pivot)
                store(below, g, load(below, g) + where_less(pivot, zero, one, zero))
            square = beside[i] * beside[i]
        for g in range(groups):
            middle = 0.5 * (load(low, g) + load(high, g))
            number, found = load(wanted, g), load(below, g)
            store(high, g, where_less(number, found, middle, load(high, g)))
            store(low, g, where_less(number, found, load(low, g), middle))
