"""Mass and stiffness matrices, one structure in each vector lane, and the standard problem made of them.

K phi = omega^2 M phi becomes the standard problem of A = F^-1 K F^-T, F F' = M; where M is diagonal F is its
root. Matrices (n n, LANES) have their entries in C order, of which the lower half counts.

Damping matrices: where all are zero, whether they are positive, and products with them.

C is that of degrees of freedom, D that of classical modes, see `complex_modes`.
"""

import numpy as np

from pymc_features.algebra import MASSLESS
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import load, splat, square_root, store, where_less
from pymc_features.simulators.compiled.vector_memory import read_lanes, write_lanes


@jit
def all_diagonal(stack, n):
    """Whether all matrices of a stack (terms, n n) are diagonal."""
    for term in range(stack.shape[0]):
        for i in range(n):
            for j in range(n):
                if i != j and stack[term, i * n + j] != 0.0:
                    return False
    return True


@jit
def assemble_lanes(stack, theta, n, whole, matrix):
    """Write A_0 + sum_i theta_i A_i into a matrix of all lanes.

    Parameters
    ----------
    stack : array (1 + p, n n) or (1, n n)
    theta : array (p, LANES)
    n : int
    whole : bool
        Whether the upper half is written too.
    matrix : array (n n, LANES)
    """
    for i in range(n):
        for j in range(n if whole else i + 1):
            e = i * n + j
            total = splat(stack[0, e])
            for term in range(1, stack.shape[0]):
                share = stack[term, e]
                if share != 0.0:
                    total = total + load(theta, term - 1) * share
            store(matrix, e, total)


@jit
def root(pivot, whole):
    """Square root of a pivot; NaN where it is no longer positive beside its diagonal entry."""
    return where_less(whole * MASSLESS, pivot, square_root(pivot), splat(0.0) * square_root(splat(-1.0)))


@jit
def factorise_lanes(matrix, n, is_diagonal):
    """Overwrite matrices by their Cholesky factors; NaN in the lanes where one is not positive definite."""
    entries = matrix.ctypes.data
    for j in range(n):
        whole = read_lanes(entries, j * n + j)
        pivot = whole
        for k in range(0 if not is_diagonal else j, j):
            entry = read_lanes(entries, j * n + k)
            pivot = pivot - entry * entry
        pivot = root(pivot, whole)
        write_lanes(entries, j * n + j, pivot)
        for i in range(j + 1, n if not is_diagonal else j, 4):
            divide_four(entries, n, (i, j), splat(1.0) / pivot)


@jit
def divide_four(entries, n, place, inverse):
    """Finish entries i ... i + 3 of column j of a Cholesky factor; what stands behind the last repeats it.

    `entries` is the address of the matrix, `inverse` that of the pivot.
    """
    i, j = place
    a, b, c, d = n * i, n * min(i + 1, n - 1), n * min(i + 2, n - 1), n * min(i + 3, n - 1)
    of_a, of_b = read_lanes(entries, a + j), read_lanes(entries, b + j)
    of_c, of_d = read_lanes(entries, c + j), read_lanes(entries, d + j)
    for k in range(j):
        factor = read_lanes(entries, n * j + k)
        of_a, of_b = of_a - factor * read_lanes(entries, a + k), of_b - factor * read_lanes(entries, b + k)
        of_c, of_d = of_c - factor * read_lanes(entries, c + k), of_d - factor * read_lanes(entries, d + k)
    write_lanes(entries, a + j, of_a * inverse)
    write_lanes(entries, b + j, of_b * inverse)
    write_lanes(entries, c + j, of_c * inverse)
    write_lanes(entries, d + j, of_d * inverse)


@jit
def standard_lanes(stiffness, factor, n, is_diagonal, reduced):
    """Write A = F^-1 K F^-T, the lower half (what stands above it is overwritten)."""
    for i in range(n):
        inverse = splat(1.0) / load(factor, i * n + i)
        if is_diagonal:
            for j in range(i + 1):
                store(reduced, i * n + j, load(stiffness, i * n + j) * inverse / load(factor, j * n + j))
            continue
        for j in range(n):  # a row of F^-1 K
            entry = load(stiffness, i * n + j) if j <= i else load(stiffness, j * n + i)
            for k in range(i):
                entry = entry - load(factor, i * n + k) * load(reduced, k * n + j)
            store(reduced, i * n + j, entry * inverse)
    if not is_diagonal:
        for i in range(n):
            for j in range(i + 1):
                entry = load(reduced, i * n + j)
                for k in range(j):
                    entry = entry - load(reduced, i * n + k) * load(factor, j * n + k)
                store(reduced, i * n + j, entry / load(factor, j * n + j))


@jit
def divide_columns(factor, n, is_diagonal, vectors):
    """Overwrite vectors (n w, LANES), entry i of column c in row i w + c, by F^-1 times them."""
    width = vectors.shape[0] // n
    for i in range(n):
        inverse = splat(1.0) / load(factor, i * n + i)
        for c in range(width):
            entry = load(vectors, i * width + c)
            for k in range(i if not is_diagonal else 0):
                entry = entry - load(factor, i * n + k) * load(vectors, k * width + c)
            store(vectors, i * width + c, entry * inverse)


@jit
def divide_transposed(factor, n, is_diagonal, vectors):
    """Multiply columns by F^-T, as `divide_columns` does by F^-1."""
    width = vectors.shape[0] // n
    for i in range(n - 1, -1, -1):
        inverse = splat(1.0) / load(factor, i * n + i)
        for c in range(width):
            entry = load(vectors, i * width + c)
            for k in range(i + 1, n if not is_diagonal else i + 1):
                entry = entry - load(factor, k * n + i) * load(vectors, k * width + c)
            store(vectors, i * width + c, entry * inverse)


@jit
def divide_rows(factor, n, vectors):
    """Overwrite n vectors, each a row of `vectors` (n n, LANES), by F^-T times them."""
    f, rows = factor.ctypes.data, vectors.ctypes.data
    for i in range(n - 1, -1, -1):
        inverse = splat(1.0) / read_lanes(f, i * n + i)
        for r in range(0, n * n, n):
            entry = read_lanes(rows, r + i)
            for k in range(i + 1, n):
                entry = entry - read_lanes(f, k * n + i) * read_lanes(rows, r + k)
            write_lanes(rows, r + i, entry * inverse)


@jit
def energy_lanes(stiffness, shape):
    """x' K x of vectors (n, LANES), and the sum of its absolute terms."""
    n = shape.shape[0]
    energy = terms = splat(0.0)
    for i in range(n):
        along = splat(0.0)
        size = splat(0.0)
        x = load(shape, i)
        for j in range(i):
            product = load(stiffness, i * n + j) * load(shape, j)
            along = along + product
            size = size + where_less(product, splat(0.0), 0.0 - product, product)
        twice = x * along * 2.0
        own = x * x * load(stiffness, i * n + i)
        energy = energy + twice + own
        x = where_less(x, splat(0.0), 0.0 - x, x)
        terms = terms + 2.0 * x * size + where_less(own, splat(0.0), 0.0 - own, own)
    return energy, terms


@jit
def multiply_lanes(left, right, sizes, out, whole):
    """Write a product of two matrices, in blocks of four rows and columns.

    Parameters
    ----------
    left, right : tuple of array (.., LANES), int, int
        Entry (r, i) is in row r p + i q of the array, p and q the numbers.
    sizes : tuple of int
        Rows of the left matrix, its columns, and columns of the right one.
    out : array (.., LANES)
        Written in C order.
    whole : bool
        False of a product that is symmetric: its upper half is then copied from the lower one.
    """
    (x, x_down, x_along), (y, y_down, y_along), (n, inner, m) = left, right, sizes
    for r in range(0, n, 4):  # what stands behind the last row or column repeats it
        r1, r2, r3 = min(r + 1, n - 1), min(r + 2, n - 1), min(r + 3, n - 1)
        for s in range(0, m if whole else min(r + 4, m), 4):
            s1, s2, s3 = min(s + 1, m - 1), min(s + 2, m - 1), min(s + 3, m - 1)
            a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = splat(0.0)
            c0 = c1 = c2 = c3 = d0 = d1 = d2 = d3 = splat(0.0)
            for i in range(inner):
                k, h = i * x_along, i * y_down
                y0, y1 = load(y, h + s * y_along), load(y, h + s1 * y_along)
                y2, y3 = load(y, h + s2 * y_along), load(y, h + s3 * y_along)
                factor = load(x, r * x_down + k)
                a0, a1, a2, a3 = a0 + factor * y0, a1 + factor * y1, a2 + factor * y2, a3 + factor * y3
                factor = load(x, r1 * x_down + k)
                b0, b1, b2, b3 = b0 + factor * y0, b1 + factor * y1, b2 + factor * y2, b3 + factor * y3
                factor = load(x, r2 * x_down + k)
                c0, c1, c2, c3 = c0 + factor * y0, c1 + factor * y1, c2 + factor * y2, c3 + factor * y3
                factor = load(x, r3 * x_down + k)
                d0, d1, d2, d3 = d0 + factor * y0, d1 + factor * y1, d2 + factor * y2, d3 + factor * y3
            places = s, s1, s2, s3
            store_four(out, r * m, places, (a0, a1, a2, a3))
            store_four(out, r1 * m, places, (b0, b1, b2, b3))
            store_four(out, r2 * m, places, (c0, c1, c2, c3))
            store_four(out, r3 * m, places, (d0, d1, d2, d3))
    for r in range(0 if whole else n):
        for s in range(r):
            store(out, s * m + r, load(out, r * m + s))


@jit
def store_four(matrix, row, places, vectors):
    """Write four entries of a row."""
    store(matrix, row + places[0], vectors[0])
    store(matrix, row + places[1], vectors[1])
    store(matrix, row + places[2], vectors[2])
    store(matrix, row + places[3], vectors[3])


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
    """Places of non-zeros of a stack (terms, n n): row after row of column j from `starts[j]` on.

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
    """Product with a right matrix (inner m, LANES) that is zero but at `filled_places`."""
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
    """Entries s and s + 1 of `multiply_rows`, for what is left behind the last four."""
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
