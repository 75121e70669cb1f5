"""How many eigenvalues of sparse structures lie below a number, many structures at a time.

By Sylvester's law of inertia K - mu M = L D L' has as many negative pivots as there are omega^2 below mu. The
structures share their pattern: where L has entries is found once, and the numbers are eliminated row by row
(Davis, ACM Trans. Math. Softw. 31, 587-591, 2005), one structure in each vector lane.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, load, magnitude, splat, store, where_less

SMALL = 1e-12  # a pivot below this share of the entries it is left of says nothing: it may be rounding


class Pattern(NamedTuple):
    """Where a symmetric matrix and its factor L have entries, in the order of elimination.

    Attributes
    ----------
    places : integer array (e,)
        Of the entries of a matrix in its own pattern: those above the diagonal by columns, and the n diagonal
        ones behind them.
    rows, starts : integer array (e - n,), (n + 1,)
        Rows of the former, and where a column begins.
    columns, row_starts : integer array (l,), (n + 1,)
        The columns in which each row of L has an entry, each before those that depend on it.
    factor_starts : integer array (n + 1,)
        Where the entries of a column of L begin.
    """

    places: np.ndarray
    rows: np.ndarray
    starts: np.ndarray
    columns: np.ndarray
    row_starts: np.ndarray
    factor_starts: np.ndarray


def elimination_pattern(rows, starts, order) -> Pattern:
    """The pattern of symmetric matrices given by columns, of which row i is eliminated as `order[i]`-th."""
    n = starts.size - 1
    columns = np.repeat(np.arange(n), np.diff(starts))
    new_rows, new_columns = order[rows].astype(np.int64), order[columns].astype(np.int64)
    diagonal = np.flatnonzero(new_rows == new_columns)
    diagonal = diagonal[np.argsort(new_columns[diagonal])]
    if diagonal.size < n:
        raise ValueError("a matrix must have all its diagonal entries in its pattern")
    upper = np.flatnonzero(new_rows < new_columns)
    upper = upper[np.lexsort((new_rows[upper], new_columns[upper]))]
    upper_rows = new_rows[upper]
    upper_starts = np.searchsorted(new_columns[upper], np.arange(n + 1)).astype(np.int64)
    found = factor_pattern(upper_rows, upper_starts)
    return Pattern(np.concatenate([upper, diagonal]), upper_rows, upper_starts, *found)


@jit
def factor_pattern(rows, starts):
    """Columns of the entries of each row of L, where a row begins, and where a column begins."""
    n = starts.size - 1
    parent, seen, counts = np.full(n, -1), np.full(n, -1), np.zeros(n + 1, dtype=np.int64)
    row_starts = np.zeros(n + 1, dtype=np.int64)
    for k in range(n):
        seen[k] = k
        for e in range(starts[k], starts[k + 1]):
            i = rows[e]
            while seen[i] != k:
                if parent[i] < 0:
                    parent[i] = k
                counts[i + 1] += 1
                row_starts[k + 1] += 1
                seen[i] = k
                i = parent[i]
    factor_starts, row_starts = np.cumsum(counts), np.cumsum(row_starts)
    columns, path = np.empty(row_starts[n], dtype=np.int64), np.empty(n, dtype=np.int64)
    seen[:] = -1
    for k in range(n):
        top = row_starts[k + 1]
        seen[k] = k
        for e in range(starts[k], starts[k + 1]):
            i, length = rows[e], 0
            while seen[i] != k:
                path[length] = i
                length += 1
                seen[i] = k
                i = parent[i]
            for j in range(length - 1, -1, -1):
                top -= 1
                columns[top] = path[j]
    return columns, row_starts, factor_starts


@jit
def count_below_lanes(pattern, stiffness, mass, theta, bounds):
    """Number of omega^2 below a bound, one structure in each lane; -1 where it cannot be told.

    Parameters
    ----------
    pattern : Pattern
    stiffness, mass : array (1 + p, e) or (1, e)
        Entries of K_0, K_1, ... and M_0, M_1, ..., in the order of `pattern.places`.
    theta : array (p, LANES)
    bounds : array (1, LANES)
        mu [(rad/s)^2].

    Returns
    -------
    array (LANES,)
    """
    n, above = pattern.starts.size - 1, pattern.rows.size
    zero, one = splat(0.0), splat(1.0)
    row, inverse = np.zeros((n, LANES)), np.empty((n, LANES))
    factor, at = (
        np.empty((max(pattern.columns.size, 1), LANES)),
        np.empty(pattern.columns.size, dtype=np.int64),
    )
    ends, found = pattern.factor_starts[:n].copy(), np.zeros((2, LANES))
    bound, negative, unsure = load(bounds, 0), zero, zero
    for k in range(n):
        for e in range(pattern.starts[k], pattern.starts[k + 1]):
            entry = summed(stiffness, theta, e) - bound * summed(mass, theta, e)
            store(row, pattern.rows[e], entry)
        spring, inertia = summed(stiffness, theta, above + k), bound * summed(mass, theta, above + k)
        pivot = spring - inertia
        for c in range(pattern.row_starts[k], pattern.row_starts[k + 1]):
            i = pattern.columns[c]
            entry = load(row, i)
            store(row, i, zero)
            for e in range(pattern.factor_starts[i], ends[i]):
                store(row, at[e], load(row, at[e]) - load(factor, e) * entry)
            share = entry * load(inverse, i)
            pivot = pivot - share * entry
            store(factor, ends[i], share)
            at[ends[i]] = k
            ends[i] += 1
        store(inverse, k, one / pivot)
        negative = negative + where_less(pivot, zero, one, zero)
        size = magnitude(spring) + magnitude(inertia)
        unsure = unsure + where_less(SMALL * size, magnitude(pivot), zero, one)  # NaN too
    store(found, 0, negative)
    store(found, 1, unsure)
    return np.where(found[1] > 0.0, -1.0, found[0])


@jit
def summed(stack, theta, e):
    """Entry e of A_0 + sum_i theta_i A_i."""
    total = splat(stack[0, e])
    for term in range(1, stack.shape[0]):
        share = stack[term, e]
        if share != 0.0:
            total = total + load(theta, term - 1) * share
    return total
