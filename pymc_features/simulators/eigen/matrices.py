"""Mass and stiffness matrices, one structure in each vector lane, and the standard problem made of them.

K phi = omega^2 M phi becomes the standard problem of A = F^-1 K F^-T, F F' = M; where M is diagonal F is its
root. Matrices (n n, LANES) have their entries in C order, of which the lower half counts.
"""

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
    """As `divide_columns`, by F^-T."""
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
