"""Symmetric matrices, one in each vector lane, made tridiagonal by Householder's reflections.

Each reflection H = 1 - beta v v' changes the remaining matrix by A - v w' - w v'. That update and the product
of the updated matrix with the next v go through memory together, which is what the time is spent on.
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import load, splat, square_root, store, where_less
from pymc_features.simulators.compiled.vector_memory import read_lanes, write_lanes


@jit
def reflect_column(matrix, n, k, vector):
    """Turn column k below the diagonal into (alpha, 0, ...); returns alpha and beta.

    v is written in place of the column, and into `vector` (n, LANES).
    """
    rest = splat(0.0)
    for i in range(k + 2, n):
        entry = load(matrix, i * n + k)
        rest = rest + entry * entry
        store(vector, i, entry)
    first = load(matrix, (k + 1) * n + k)
    alpha = square_root(rest + first * first)
    alpha = where_less(first, splat(0.0), alpha, splat(0.0) - alpha)
    first = first - alpha
    store(vector, k + 1, first)
    store(matrix, (k + 1) * n + k, first)
    square = rest + first * first
    return alpha, where_less(splat(0.0), square, splat(2.0) / square, splat(0.0))


@jit
def update_and_multiply(matrix, start, vectors):
    """Write A - v w' - w v', from row and column `start` on, and its product with u.

    Parameters
    ----------
    matrix : array (n n, LANES)
        The lower half is read and written.
    vectors : tuple of arrays (n, LANES)
        v, w, u and the product, which is overwritten.
    """
    v, w, u, product = vectors
    n = v.shape[0]
    for i in range(start, n):
        store(product, i, splat(0.0))
    begin = start
    if (n - start) % 2 == 1:  # the first row alone, the others in pairs
        entry = load(matrix, start * n + start) - (
            load(v, start) * load(w, start) + load(w, start) * load(v, start)
        )
        store(matrix, start * n + start, entry)
        store(product, start, entry * load(u, start))
        begin = start + 1
    for i in range(begin, n, 2):
        top, low = i * n, (i + 1) * n
        v0, v1, w0, w1, u0, u1 = (
            load(v, i),
            load(v, i + 1),
            load(w, i),
            load(w, i + 1),
            load(u, i),
            load(u, i + 1),
        )
        sum0 = sum1 = splat(0.0)
        for j in range(start, i):
            vj, wj, uj = load(v, j), load(w, j), load(u, j)
            a0 = load(matrix, top + j) - v0 * wj - w0 * vj
            a1 = load(matrix, low + j) - v1 * wj - w1 * vj
            store(matrix, top + j, a0)
            store(matrix, low + j, a1)
            sum0, sum1 = sum0 + a0 * uj, sum1 + a1 * uj
            store(product, j, load(product, j) + a0 * u0 + a1 * u1)
        corner = load(matrix, top + i) - (v0 * w0 + w0 * v0)
        beside = load(matrix, low + i) - v1 * w0 - w1 * v0
        last = load(matrix, low + i + 1) - (v1 * w1 + w1 * v1)
        store(matrix, top + i, corner)
        store(matrix, low + i, beside)
        store(matrix, low + i + 1, last)
        store(product, i, sum0 + corner * u0 + beside * u1)
        store(product, i + 1, sum1 + beside * u0 + last * u1)


@jit
def turn_rows(vectors, start, v, beta, sums):
    """Multiply columns of vectors, (n w, LANES), by the reflection; `sums` (w, LANES) are overwritten."""
    n = v.shape[0]
    width = vectors.shape[0] // n
    for c in range(width):
        store(sums, c, splat(0.0))
    for i in range(start, n):
        entry = load(v, i)
        for c in range(width):
            store(sums, c, load(sums, c) + entry * load(vectors, i * width + c))
    for i in range(start, n):
        entry = beta * load(v, i)
        for c in range(width):
            store(vectors, i * width + c, load(vectors, i * width + c) - entry * load(sums, c))


@jit
def tridiagonalise(matrix, diagonal, off_diagonal, vectors, room):
    """Write the tridiagonal matrix that is similar to each symmetric one, and turn vectors with it.

    Parameters
    ----------
    matrix : array (n n, LANES)
        The lower half is read; column k below the diagonal is overwritten by v of reflection k.
    diagonal, off_diagonal : array (n, LANES)
        Written, zero behind the n - 1 entries beside the diagonal.
    vectors : array (n w, LANES)
        As in `tridiagonal.diagonalise_lanes`.
    room : tuple of arrays
        beta of all reflections, written, and room for v, w, the next v and a product, each (n, LANES), and
        for sums (w, LANES).
    """
    n = diagonal.shape[0]
    betas, v, w, u, product, sums = room
    for i in range(n):
        store(v, i, splat(0.0))
        store(w, i, splat(0.0))
        store(off_diagonal, i, splat(0.0))
    for k in range(n - 2):
        alpha, beta = reflect_column(matrix, n, k, u)
        store(off_diagonal, k, alpha)
        store(betas, k, beta)
        update_and_multiply(matrix, k + 1, (v, w, u, product))
        along = splat(0.0)
        for i in range(k + 1, n):
            along = along + load(product, i) * load(u, i)
        half = splat(0.5) * beta * beta * along
        for i in range(k + 1, n):
            here = load(u, i)
            store(w, i, beta * load(product, i) - half * here)
            store(v, i, here)
        turn_rows(vectors, k + 1, v, beta, sums)
        first, first_w = load(v, k + 1), load(w, k + 1)
        for i in range(k + 2, n):  # the column that the next reflection is made of
            row = i * n + k + 1
            store(matrix, row, load(matrix, row) - load(v, i) * first_w - load(w, i) * first)
        here = (k + 1) * n + k + 1
        store(matrix, here, load(matrix, here) - (first * first_w + first_w * first))
    if n > 1:
        end = (n - 1) * n + n - 1
        last, last_w = load(v, n - 1), load(w, n - 1)
        store(matrix, end, load(matrix, end) - (last * last_w + last_w * last))
        store(off_diagonal, n - 2, load(matrix, end - 1))
    for i in range(n):
        store(diagonal, i, load(matrix, i * n + i))


@jit
def reflect_back(matrix, betas, vector):
    """Overwrite a vector (n, LANES) of the tridiagonal matrix by that of the matrix it was made of."""
    n = vector.shape[0]
    for k in range(n - 3, -1, -1):
        along = splat(0.0)
        for i in range(k + 1, n):
            along = along + load(matrix, i * n + k) * load(vector, i)
        along = along * load(betas, k)
        for i in range(k + 1, n):
            store(vector, i, load(vector, i) - along * load(matrix, i * n + k))


@jit
def reflect_rows(matrix, betas, vectors):
    """As `reflect_back`, of n vectors, each a row of `vectors` (n n, LANES), four at a time."""
    n, rows, v, beta = betas.shape[0], vectors.ctypes.data, matrix.ctypes.data, betas.ctypes.data
    for r in range(0, n, 4):  # what stands behind the last row repeats it
        a, b, c, d = n * r, n * min(r + 1, n - 1), n * min(r + 2, n - 1), n * min(r + 3, n - 1)
        for k in range(n - 3, -1, -1):
            of_a = of_b = of_c = of_d = splat(0.0)
            for i in range(k + 1, n):
                entry = read_lanes(v, i * n + k)
                of_a, of_b = of_a + entry * read_lanes(rows, a + i), of_b + entry * read_lanes(rows, b + i)
                of_c, of_d = of_c + entry * read_lanes(rows, c + i), of_d + entry * read_lanes(rows, d + i)
            factor = read_lanes(beta, k)
            of_a, of_b, of_c, of_d = factor * of_a, factor * of_b, factor * of_c, factor * of_d
            for i in range(k + 1, n):
                entry = read_lanes(v, i * n + k)
                new_a, new_b = read_lanes(rows, a + i) - of_a * entry, read_lanes(rows, b + i) - of_b * entry
                new_c, new_d = read_lanes(rows, c + i) - of_c * entry, read_lanes(rows, d + i) - of_d * entry
                write_lanes(rows, a + i, new_a)
                write_lanes(rows, b + i, new_b)
                write_lanes(rows, c + i, new_c)
                write_lanes(rows, d + i, new_d)
