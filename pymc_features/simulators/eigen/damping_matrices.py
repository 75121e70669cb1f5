"""Damping matrices: where all are zero, whether they are positive, and products with them.

C is that of degrees of freedom, D that of classical modes, see `complex_modes`.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import load, splat, store, where_less
from pymc_features.simulators.compiled.vector_memory import read_lanes, write_lanes

PANEL = 2  # complex modes that are multiplied by D together
POSITIVE = 1e-12  # a pivot above that share of its diagonal entry is positive in spite of rounding


@jit
def is_never_negative(stack, n):
    """Whether C, a stack (terms, n n), does not depend on theta and has no negative eigenvalue.

    By its Cholesky factor; rows that are zero are passed over. False if rounding leaves a doubt.
    """
    matrix = stack[0].copy().reshape((n, n))
    for j in range(n):
        whole = matrix[j, j]
        for k in range(j):
            matrix[j, j] -= matrix[j, k] ** 2
        if whole == 0.0 and not np.any(matrix[j]) and not np.any(matrix[:, j]):
            continue
        if not matrix[j, j] > POSITIVE * whole:
            return False
        matrix[j, j] = np.sqrt(matrix[j, j])
        for i in range(j + 1, n):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            matrix[i, j] /= matrix[j, j]
    return stack.shape[0] == 1


@jit
def filled_places(stack, n):
    """Where matrices of a stack (terms, n n) are not zero: row after row of column j from `starts[j]` on.

    Returns
    -------
    starts, rows : integer arrays (n + 1,) and as many as there are places
    """
    starts, rows, count = np.zeros(n + 1, dtype=np.int64), np.empty(n * n, dtype=np.int64), 0
    for j in range(n):
        for i in range(n):
            for term in range(stack.shape[0]):
                if stack[term, i * n + j] != 0.0:
                    rows[count], count = i, count + 1
                    break
        starts[j + 1] = count
    return starts, rows[:count]


@jit
def multiply_sparse(left, right, places, sizes, out):
    """As `multiply_lanes`, of a right matrix (inner m, LANES) that is zero but at `filled_places`."""
    (x, x_down, x_along), (starts, rows), (n, m) = left, places, sizes
    for r in range(0, n, 4):  # what stands behind the last row repeats it
        r1, r2, r3 = min(r + 1, n - 1), min(r + 2, n - 1), min(r + 3, n - 1)
        for j in range(m):
            a = b = c = d = splat(0.0)
            for place in range(starts[j], starts[j + 1]):
                i = rows[place]
                factor, k = load(right, i * m + j), i * x_along
                a, b = a + factor * load(x, r * x_down + k), b + factor * load(x, r1 * x_down + k)
                c, d = c + factor * load(x, r2 * x_down + k), d + factor * load(x, r3 * x_down + k)
            store(out, r * m + j, a)
            store(out, r1 * m + j, b)
            store(out, r2 * m + j, c)
            store(out, r3 * m + j, d)


@jit
def multiply_rows(at, s, live):
    """Write entries s ... s + 3 of D x of the panel in the lanes that are `live`.

    What stands behind the last entry repeats it.
    """
    m, x = at.m, at.vectors
    s1, s2, s3 = min(s + 1, m - 1), min(s + 2, m - 1), min(s + 3, m - 1)
    a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = splat(0.0)
    c0 = c1 = c2 = c3 = e0 = e1 = e2 = e3 = splat(0.0)
    for t in range(m):
        k = 2 * PANEL * t
        x0, x1, x2, x3 = read_lanes(x, k), read_lanes(x, k + 1), read_lanes(x, k + 2), read_lanes(x, k + 3)
        d0, d1 = read_lanes(at.damping, s * m + t), read_lanes(at.damping, s1 * m + t)
        d2, d3 = read_lanes(at.damping, s2 * m + t), read_lanes(at.damping, s3 * m + t)
        a0, a1, a2, a3 = a0 + d0 * x0, a1 + d0 * x1, a2 + d0 * x2, a3 + d0 * x3
        b0, b1, b2, b3 = b0 + d1 * x0, b1 + d1 * x1, b2 + d1 * x2, b3 + d1 * x3
        c0, c1, c2, c3 = c0 + d2 * x0, c1 + d2 * x1, c2 + d2 * x2, c3 + d2 * x3
        e0, e1, e2, e3 = e0 + d3 * x0, e1 + d3 * x1, e2 + d3 * x2, e3 + d3 * x3
    write_four(at.products, 2 * PANEL * s, (a0, a1, a2, a3), live)
    write_four(at.products, 2 * PANEL * s1, (b0, b1, b2, b3), live)
    write_four(at.products, 2 * PANEL * s2, (c0, c1, c2, c3), live)
    write_four(at.products, 2 * PANEL * s3, (e0, e1, e2, e3), live)


@jit
def multiply_two_rows(at, s, live):
    """As `multiply_rows`, of entries s and s + 1, for what is left behind the last four."""
    m, x = at.m, at.vectors
    s1 = min(s + 1, m - 1)
    a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = splat(0.0)
    for t in range(m):
        k = 2 * PANEL * t
        x0, x1, x2, x3 = read_lanes(x, k), read_lanes(x, k + 1), read_lanes(x, k + 2), read_lanes(x, k + 3)
        d0, d1 = read_lanes(at.damping, s * m + t), read_lanes(at.damping, s1 * m + t)
        a0, a1, a2, a3 = a0 + d0 * x0, a1 + d0 * x1, a2 + d0 * x2, a3 + d0 * x3
        b0, b1, b2, b3 = b0 + d1 * x0, b1 + d1 * x1, b2 + d1 * x2, b3 + d1 * x3
    write_four(at.products, 2 * PANEL * s, (a0, a1, a2, a3), live)
    write_four(at.products, 2 * PANEL * s1, (b0, b1, b2, b3), live)


@jit
def write_four(address, row, vectors, live):
    """Write four vectors, one after the other, in the lanes that are `live`."""
    zero = splat(0.0)
    write_lanes(address, row, where_less(zero, live, vectors[0], read_lanes(address, row)))
    write_lanes(address, row + 1, where_less(zero, live, vectors[1], read_lanes(address, row + 1)))
    write_lanes(address, row + 2, where_less(zero, live, vectors[2], read_lanes(address, row + 2)))
    write_lanes(address, row + 3, where_less(zero, live, vectors[3], read_lanes(address, row + 3)))
