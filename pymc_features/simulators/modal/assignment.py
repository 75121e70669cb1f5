"""The best assignment of rows to columns: each row its own column, at the least total cost."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit

IMPOSSIBLE = 1e100  # what a cost that is infinite or NaN counts as


@jit
def assign(cost, column_of):
    """Write the column of each row; shortest augmenting paths with dual prices, O(rows^2 columns).

    (Jonker & Volgenant, Computing 38, 325-340, 1987.)

    Parameters
    ----------
    cost : array (g, m)
        With g <= m.
    column_of : integer array (g,)
        Written.
    """
    n_rows, n_columns = cost.shape
    row_price, column_price = np.zeros(n_rows), np.zeros(n_columns)
    row_of = np.full(n_columns, -1)
    for row in range(n_rows):
        distance, before = np.full(n_columns, np.inf), np.full(n_columns, -1)
        reached = np.zeros(n_columns, dtype=np.bool_)
        here, at, shortest = row, -1, 0.0  # the row looked at, the column that led there, and how far it is
        while True:
            nearest, step = -1, np.inf
            for j in range(n_columns):
                if reached[j]:
                    continue
                entry = cost[here, j]
                own = (entry if abs(entry) < IMPOSSIBLE else IMPOSSIBLE) - row_price[here] - column_price[j]
                if shortest + own < distance[j]:
                    distance[j], before[j] = shortest + own, at
                if distance[j] < step:
                    nearest, step = j, distance[j]
            shortest, at = step, nearest
            reached[at] = True
            if row_of[at] < 0:
                break
            here = row_of[at]
        row_price[row] += shortest
        for j in range(n_columns):
            if reached[j] and row_of[j] >= 0:
                row_price[row_of[j]] += shortest - distance[j]
                column_price[j] -= shortest - distance[j]
        while at >= 0:  # back along the path
            row_of[at] = row if before[at] < 0 else row_of[before[at]]
            at = before[at]
    for j in range(n_columns):
        if row_of[j] >= 0:
            column_of[row_of[j]] = j


@jit
def assignments(cost):
    """Which column each row takes, 1 where it does and 0 elsewhere: (p, g, m) for costs (p, g, m)."""
    chosen = np.zeros(cost.shape)
    column_of = np.zeros(cost.shape[1], dtype=np.int64)
    for p in range(cost.shape[0]):
        assign(cost[p], column_of)
        for row in range(column_of.size):
            chosen[p, row, column_of[row]] = 1.0
    return chosen
