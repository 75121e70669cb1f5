"""Mass, damping and stiffness matrices, one structure in each vector lane.

K phi = omega^2 M phi becomes the standard problem of A = F^-1 K F^-T, F F' = M; where M is diagonal F is its
root. Matrices (n n, LANES) have their entries in C order, of which the lower half counts.

Products go in blocks of four rows and columns, which stay in registers.
"""

from pymc_features.algebra import MASSLESS
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import (
    in_lanes,
    magnitude,
    new_four,
    square_root,
    where_less,
)
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.numbers.vectors import load, splat, store


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
    entries = view(matrix, in_lanes(0.0))
    for j in range(n):
        whole = pivot = load(matrix, j * n + j)
        for k in range(0 if not is_diagonal else j, j):
            entry = load(matrix, j * n + k)
            pivot = pivot - entry * entry
        store(matrix, j * n + j, root(pivot, whole))
        for i in range(j + 1, n if not is_diagonal else j, 4):
            divide_four(entries, n, i, j)


@jit
def four_of(rows, places, k):
    """Numbers k behind each of four places."""
    a, b, c, d = places
    return new_four(rows[a + k], rows[b + k], rows[c + k], rows[d + k])


@jit
def put_four_of(rows, places, k, x):
    """Write numbers k behind each of four places."""
    a, b, c, d = places
    rows[a + k], rows[b + k], rows[c + k], rows[d + k] = x.first, x.second, x.third, x.fourth


@jit
def four_from(first, size, last):
    """Starts of four rows of some size; what would stand behind the last one repeats it."""
    b, c, d = min(first + 1, last), min(first + 2, last), min(first + 3, last)
    return size * first, size * b, size * c, size * d


@jit
def divide_four(entries, n, i, j):
    """Finish entries i ... i + 3 of column j of a Cholesky factor."""
    places = four_from(i, n, n - 1)
    total = four_of(entries, places, j)
    for k in range(j):
        total = total - entries[n * j + k] * four_of(entries, places, k)
    put_four_of(entries, places, j, total * (1.0 / entries[n * j + j]))


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
def divide_rows(factor, n, is_diagonal, vectors):
    """Overwrite vectors, each a row of `vectors` (.. n, LANES), by F^-T times them."""
    f, rows, one = view(factor, in_lanes(0.0)), view(vectors, in_lanes(0.0)), in_lanes(1.0)
    for i in range(n - 1, -1, -1):
        inverse = one / f[i * n + i]
        for r in range(0, vectors.shape[0], n):
            entry = rows[r + i]
            for k in range(i + 1, n if not is_diagonal else i):
                entry = entry - f[k * n + i] * rows[r + k]
            rows[r + i] = entry * inverse


@jit
def energy_lanes(stiffness, shape):
    """x' K x of vectors (n, LANES), and the sum of its absolute terms."""
    energy = terms = splat(0.0)
    for i in range(shape.shape[0]):
        x, along, size = load(shape, i), splat(0.0), splat(0.0)
        for j in range(i):
            product = load(stiffness, i * shape.shape[0] + j) * load(shape, j)
            along, size = along + product, size + magnitude(product)
        own = x * x * load(stiffness, i * shape.shape[0] + i)
        energy = energy + 2.0 * (x * along) + own
        terms = terms + 2.0 * (magnitude(x) * size) + magnitude(own)
    return energy, terms


@jit
def multiply_lanes(left, right, sizes, out):
    """Write a product of two matrices, in blocks of four rows and columns.

    Parameters
    ----------
    left, right : tuple of array (.., LANES), int, int
        Entry (r, i) is in row r p + i q of the array, p and q the numbers.
    sizes : tuple of int
        Rows of the left matrix, its columns, and columns of the right one.
    out : array (.., LANES)
        Written in C order.
    """
    (x, x_down, x_along), (y, y_down, y_along), (n, inner, m) = left, right, sizes
    like = in_lanes(0.0)
    x, y, product = view(x, like), view(y, like), view(out, like)
    for r in range(0, n, 4):
        lines, rows = four_from(r, x_down, n - 1), four_from(r, m, n - 1)
        for s in range(0, m, 4):
            columns, places = four_from(s, y_along, m - 1), four_from(s, 1, m - 1)
            a = b = c = d = new_four(like, like, like, like)
            for i in range(inner):
                factors, row = four_of(x, lines, i * x_along), four_of(y, columns, i * y_down)
                a, b = a + factors.first * row, b + factors.second * row
                c, d = c + factors.third * row, d + factors.fourth * row
            put_four_of(product, places, rows[0], a)
            put_four_of(product, places, rows[1], b)
            put_four_of(product, places, rows[2], c)
            put_four_of(product, places, rows[3], d)
