"""Modes of many dense structures, one in each vector lane: frequencies, and the shapes times vectors.

Householder's reflections and QL turn only the vectors that are asked for: rows of the sensors, the load, the
forces. Frequencies far below the largest get their digits back from Rayleigh quotients. What lanes cannot do,
masses that are zero and frequencies that may be imaginary, is left to whoever solves one structure at a time.

Symmetric matrices, one in each vector lane, made tridiagonal by Householder's reflections.

Each reflection H = 1 - beta v v' changes the remaining matrix by A - v w' - w v'. That update and the product
of the updated matrix with the next v go through memory together, which is what the time is spent on.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.algebra import ROUNDING
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import (
    LANES,
    highest,
    load,
    magnitude,
    splat,
    square_root,
    store,
    where_less,
)
from pymc_features.simulators.compiled.vector_memory import new_vectors, read_lanes, write_lanes
from pymc_features.simulators.eigen.matrices import (
    assemble_lanes,
    divide_columns,
    divide_rows,
    divide_transposed,
    energy_lanes,
    factorise_lanes,
    standard_lanes,
)
from pymc_features.simulators.eigen.tridiagonal import (
    REACH,
    ROUNDS,
    SETTLED,
    are_apart,
    diagonalise_lanes,
    has_lost,
    largest_values,
    twisted_vector,
    values_of_lanes,
    whole_vectors,
)


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
def reflect_four(rows, places, v, beta, size):
    """Multiply four vectors by reflections k and k - 1, or by k alone where it is zero.

    Parameters
    ----------
    rows, v, beta : int
        Addresses of the vectors, of the matrix whose columns are v, and of beta.
    places : tuple of int
        Where each of the four begins.
    size : tuple of int
        k and n.
    """
    (a, b, c, d), (k, n) = places, size
    e0 = e1 = e2 = e3 = f0 = f1 = f2 = f3 = both = splat(0.0)  # v_k'x, v_(k-1)'x, v_k'v_(k-1)
    low, is_single = max(k - 1, 0), k == 0
    for i in range(k + 1, n):
        first, second = read_lanes(v, i * n + k), read_lanes(v, i * n + low)
        x0, x1, x2, x3 = read_four(rows, (a + i, b + i, c + i, d + i))
        e0, e1, e2, e3 = e0 + first * x0, e1 + first * x1, e2 + first * x2, e3 + first * x3
        f0, f1, f2, f3 = f0 + second * x0, f1 + second * x1, f2 + second * x2, f3 + second * x3
        both = both + first * second
    factor = read_lanes(beta, k)
    e0, e1, e2, e3 = factor * e0, factor * e1, factor * e2, factor * e3
    factor, start = splat(0.0) if is_single else read_lanes(beta, low), read_lanes(v, k * n + low)
    x0, x1, x2, x3 = read_four(rows, (a + k, b + k, c + k, d + k))
    f0, f1 = factor * (f0 + start * x0 - both * e0), factor * (f1 + start * x1 - both * e1)
    f2, f3 = factor * (f2 + start * x2 - both * e2), factor * (f3 + start * x3 - both * e3)
    write_four(
        rows,
        (a + k, b + k, c + k, d + k),
        (x0 - f0 * start, x1 - f1 * start, x2 - f2 * start, x3 - f3 * start),
    )
    for i in range(k + 1, n):
        first, second = read_lanes(v, i * n + k), read_lanes(v, i * n + low)
        x0, x1, x2, x3 = read_four(rows, (a + i, b + i, c + i, d + i))
        x0, x1 = x0 - e0 * first - f0 * second, x1 - e1 * first - f1 * second
        x2, x3 = x2 - e2 * first - f2 * second, x3 - e3 * first - f3 * second
        write_four(rows, (a + i, b + i, c + i, d + i), (x0, x1, x2, x3))


@jit
def read_four(address, places):
    """Four vectors."""
    a, b, c, d = places
    return read_lanes(address, a), read_lanes(address, b), read_lanes(address, c), read_lanes(address, d)


@jit
def write_four(address, places, vectors):
    """Write four vectors."""
    write_lanes(address, places[0], vectors[0])
    write_lanes(address, places[1], vectors[1])
    write_lanes(address, places[2], vectors[2])
    write_lanes(address, places[3], vectors[3])


@jit
def reflect_rows(matrix, betas, vectors):
    """Reflect n vectors back, each a row of `vectors` (n n, LANES), four at a time.

    Reflections k and k - 1 go through memory together; what would follow the last one is none.
    """
    n, rows, v, beta = betas.shape[0], vectors.ctypes.data, matrix.ctypes.data, betas.ctypes.data
    for r in range(0, n, 4):  # what stands behind the last row repeats it
        a, b, c, d = n * r, n * min(r + 1, n - 1), n * min(r + 2, n - 1), n * min(r + 3, n - 1)
        for k in range(n - 3, -1, -2):
            reflect_four(rows, (a, b, c, d), v, beta, (k, n))


class StructureLanes(NamedTuple):
    """Eigenproblems of dense structures, one in each lane.

    Attributes
    ----------
    is_good : bool array (LANES,)
        Lanes that came out right; the others must be solved alone.
    theta : array (p, LANES)
    stiffness, factor, reduced : array (n n, LANES)
        K, the Cholesky factor of M, and A.
    diagonal, off_diagonal, values, work : array (n, LANES)
        Of the tridiagonal matrix, omega^2, and what QL overwrites.
    vectors : array (n w, LANES)
        Products of mode i with w vectors, in rows i w ...
    pivots, shape : array (2 n, LANES), (n, LANES)
    rows : array (n n, LANES)
        Mode shapes, where w is at least n: all are found then, and multiplied.
    room : tuple of arrays
        See `reflections.tridiagonalise`.
    """

    is_good: np.ndarray
    theta: np.ndarray
    stiffness: np.ndarray
    factor: np.ndarray
    reduced: np.ndarray
    diagonal: np.ndarray
    off_diagonal: np.ndarray
    values: np.ndarray
    work: np.ndarray
    vectors: np.ndarray
    pivots: np.ndarray
    shape: np.ndarray
    rows: np.ndarray
    room: tuple


@jit
def new_structures(n, n_theta, width):
    """Room for structures of n degrees of freedom and products with `width` vectors."""
    room = (
        new_vectors(n),
        new_vectors(n),
        new_vectors(n),
        new_vectors(n),
        new_vectors(n),
        new_vectors(width),
    )
    return StructureLanes(
        is_good=np.zeros(LANES, dtype=np.bool_),
        theta=new_vectors(n_theta),
        stiffness=new_vectors(n * n),
        factor=new_vectors(n * n),
        reduced=new_vectors(n * n),
        diagonal=new_vectors(n),
        off_diagonal=new_vectors(n),
        values=new_vectors(n),
        work=new_vectors(n),
        vectors=new_vectors(n * width),
        pivots=new_vectors(2 * n),
        shape=new_vectors(n),
        rows=new_vectors(n * n if width >= n else 0),
        room=room,
    )


@jit
def solve_structures(lanes, stacks, is_diagonal, columns):
    """Write omega^2 and the products of the mode shapes with vectors, and which lanes are good.

    Parameters
    ----------
    lanes : StructureLanes
        With theta.
    stacks : tuple of arrays (1 + p, n n) or (1, n n)
        Of M and K.
    is_diagonal : bool
        Whether M is diagonal.
    columns : tuple of arrays (n, w), (n,)
        The vectors, and influences; column w - 1 takes M influence besides.
    """
    n, width, (mass, stiffness) = lanes.diagonal.shape[0], columns[0].shape[1], stacks
    assemble_lanes(mass, lanes.theta, n, False, lanes.factor)
    assemble_lanes(stiffness, lanes.theta, n, False, lanes.stiffness)
    factorise_lanes(lanes.factor, n, is_diagonal)
    standard_lanes(lanes.stiffness, lanes.factor, n, is_diagonal, lanes.reduced)
    forward = lanes.vectors if width < n else lanes.vectors[:0]
    if width < n:
        start_products(lanes, columns, is_diagonal)
    tridiagonalise(lanes.reduced, lanes.diagonal, lanes.off_diagonal, forward, lanes.room)
    converged = diagonalise(lanes, forward) if width < n else find_values(lanes)
    if width >= n and converged:
        converged = find_shapes(lanes)
        multiply_shapes(lanes, columns, is_diagonal)
    largest = largest_values(lanes.values)
    for r in range(n):
        if highest(has_lost(load(lanes.values, r), largest)) > 0.0:
            improve_value(lanes, r, largest, is_diagonal)
    for lane in range(LANES):
        lanes.is_good[lane] = converged
        for r in range(n):  # NaN and infinity too
            lanes.is_good[lane] &= 0.0 <= lanes.values[r, lane] < np.inf


@jit
def diagonalise(lanes, vectors):
    """Write omega^2 of the tridiagonal matrices, and turn vectors to their basis; False if that fails."""
    for i in range(lanes.diagonal.shape[0]):
        store(lanes.values, i, load(lanes.diagonal, i))
        store(lanes.work, i, load(lanes.off_diagonal, i))
    return diagonalise_lanes(lanes.values, lanes.work, vectors)


@jit
def find_values(lanes):
    """Write omega^2 of the tridiagonal matrices; False if that fails."""
    for i in range(lanes.diagonal.shape[0]):
        entry = load(lanes.off_diagonal, i)
        store(lanes.values, i, load(lanes.diagonal, i))
        store(lanes.work, i, entry * entry)
    return values_of_lanes(lanes.values, lanes.work)


@jit
def start_products(lanes, columns, is_diagonal):
    """Write F^-1 times the vectors, for reflections and QL to turn."""
    (fixed, influence), n = columns, lanes.diagonal.shape[0]
    width = fixed.shape[1]
    for i in range(n):
        for c in range(width):
            store(lanes.vectors, i * width + c, splat(fixed[i, c]))
    divide_columns(lanes.factor, n, is_diagonal, lanes.vectors)
    for i in range(n):
        row = i * width + width - 1
        store(lanes.vectors, row, load(lanes.vectors, row) + moved_mass(lanes, i, influence, is_diagonal))


@jit
def moved_mass(lanes, i, influence, is_diagonal):
    """Entry i of F^-1 M influence = F' influence."""
    total, n = splat(0.0), lanes.diagonal.shape[0]
    for k in range(i, i + 1 if is_diagonal else n):
        total = total + load(lanes.factor, k * n + i) * influence[k]
    return total


@jit
def find_shapes(lanes):
    """Write the eigenvectors of A into `lanes.rows`, one by one: QL takes longer; False if that fails."""
    n, rows, converged = lanes.diagonal.shape[0], lanes.rows, True
    sort_lanes(lanes.values)
    if are_apart(lanes.values):
        whole_vectors(lanes.diagonal, lanes.off_diagonal, lanes.values, lanes.pivots, lanes.shape, rows)
    else:
        for i in range(n * n):
            store(rows, i, splat(1.0 if i % (n + 1) == 0 else 0.0))
        converged = diagonalise(lanes, rows)
    reflect_rows(lanes.reduced, lanes.room[0], rows)
    return converged


@jit
def sort_lanes(values):
    """Sort the numbers (n, LANES) of each lane."""
    for lane in range(LANES):
        for i in range(1, values.shape[0]):
            value, k = values[i, lane], i
            while k > 0 and values[k - 1, lane] > value:
                values[k, lane] = values[k - 1, lane]
                k -= 1
            values[k, lane] = value


@jit
def multiply_shapes(lanes, columns, is_diagonal):
    """Turn the eigenvectors of A into mode shapes, and write their products with the vectors."""
    (fixed, influence), n, rows, vectors = columns, lanes.diagonal.shape[0], lanes.rows, lanes.vectors
    width, inverses = fixed.shape[1], lanes.shape
    for i in range(n):
        store(lanes.pivots, i, moved_mass(lanes, i, influence, is_diagonal))
        store(inverses, i, splat(1.0) / load(lanes.factor, i * n + i))
    for r in range(n):
        share = splat(0.0)
        for i in range(n):
            entry = load(rows, r * n + i)
            share = share + entry * load(lanes.pivots, i)
            if is_diagonal:
                store(rows, r * n + i, entry * load(inverses, i))
        for c in range(width):
            store(vectors, r * width + c, share if c == width - 1 else splat(0.0))
    if not is_diagonal:
        divide_rows(lanes.factor, n, rows)
    places, count = np.empty((n * width, 2), dtype=np.int64), 0
    for i in range(n):
        for c in range(width):
            if fixed[i, c] != 0.0:
                places[count, 0], places[count, 1], count = i, c, count + 1
    for r in range(n):
        for place in range(count):
            i, c = places[place]
            row = r * width + c
            store(vectors, row, load(vectors, row) + load(rows, r * n + i) * fixed[i, c])


@jit
def improve_value(lanes, r, largest, is_diagonal):
    """Replace omega_r^2 in the lanes where it lost digits by the Rayleigh quotient of its shape.

    Zero where only rounding is left of it, -1 where the quotient is no better.
    """
    n, found = lanes.diagonal.shape[0], load(lanes.values, r)
    value, lost = found, has_lost(found, largest)
    moving = lost  # a lane that has settled stays: its number is not to depend on its neighbours
    for _ in range(ROUNDS):
        twisted_vector(lanes.diagonal, lanes.off_diagonal, value, lanes.pivots, lanes.shape)
        inertia = splat(0.0)
        for i in range(n):
            entry = load(lanes.shape, i)
            inertia = inertia + entry * entry
        reflect_back(lanes.reduced, lanes.room[0], lanes.shape)
        divide_transposed(lanes.factor, n, is_diagonal, lanes.shape)
        energy, terms = energy_lanes(lanes.stiffness, lanes.shape)
        energy = where_less(magnitude(energy), ROUNDING * terms, splat(0.0), energy)
        quotient = energy / inertia
        change = magnitude(quotient - value) - SETTLED * magnitude(quotient)
        is_zero = where_less(splat(0.0), magnitude(quotient), splat(0.0), splat(1.0))
        change = where_less(splat(0.0), is_zero, splat(-1.0), change)
        value = where_less(splat(0.0), moving, quotient, value)
        moving = where_less(splat(0.0), moving, change, splat(-1.0))
        if not highest(moving) > 0.0:
            break
    near = where_less(magnitude(value - found), REACH * largest, value, splat(-1.0))
    store(lanes.values, r, where_less(splat(0.0), lost, near, found))
