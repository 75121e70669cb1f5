"""Modes of many dense structures, one in each vector lane: frequencies and shapes.

K phi = omega^2 M phi becomes a standard problem (`matrices`), which Householder's reflections make
tridiagonal; its eigenvalues are those of QL, and its vectors are found one by one. Frequencies far below the
largest get their digits back from Rayleigh quotients. What lanes cannot do, masses that are zero and
frequencies that may be imaginary, is left to whoever solves one structure at a time.

Each reflection H = 1 - beta v v' changes the remaining matrix by A - v w' - w v'. That update and the product
of the updated matrix with the next v go through memory together, which is what the time is spent on.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.algebra import ROUNDING
from pymc_features.simulators.compiled.arrays import positions
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.eigen.matrices import (
    assemble_lanes,
    divide_rows,
    energy_lanes,
    factorise_lanes,
    four_from,
    four_of,
    put_four_of,
    standard_lanes,
)
from pymc_features.simulators.eigen.tridiagonal import (
    REACH,
    ROUNDS,
    SETTLED,
    eigenvectors,
    has_lost,
    largest_values,
    twisted_vector,
)
from pymc_features.simulators.numbers.compiled_numbers import (
    highest,
    in_lanes,
    magnitude,
    new_four,
    new_two,
    square_root,
    the_sum,
    where_less,
)
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.numbers.vectors import LANES, load, new_vectors, splat, store


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
    """Write A - v w' - w v', from row and column `start` on, and its product with u, two rows at a time.

    Parameters
    ----------
    matrix : array (n n, LANES)
        The lower half is read and written.
    vectors : tuple of arrays (n, LANES)
        v, w, u and the product, which is overwritten.
    """
    n, like = vectors[0].shape[0], in_lanes(0.0)
    a, v, w = view(matrix, like), view(vectors[0], like), view(vectors[1], like)
    u, product = view(vectors[2], like), view(vectors[3], like)
    for i in range(start, n):
        product[i] = like
    begin = start + (n - start) % 2
    if begin > start:  # the first row alone
        a[start * n + start] = a[start * n + start] - 2.0 * (v[start] * w[start])
        product[start] = a[start * n + start] * u[start]
    for i in range(begin, n, 2):
        top, low = i * n, (i + 1) * n
        vs, ws, us = new_two(v[i], v[i + 1]), new_two(w[i], w[i + 1]), new_two(u[i], u[i + 1])
        total = new_two(like, like)
        for j in range(start, i):
            entries = new_two(a[top + j], a[low + j]) - w[j] * vs - v[j] * ws
            a[top + j], a[low + j] = entries.first, entries.second
            total = total + u[j] * entries
            product[j] = product[j] + the_sum(entries * us)
        corner = a[top + i] - 2.0 * (vs.first * ws.first)
        beside = a[low + i] - vs.second * ws.first - ws.second * vs.first
        last = a[low + i + 1] - 2.0 * (vs.second * ws.second)
        a[top + i], a[low + i], a[low + i + 1] = corner, beside, last
        product[i] = total.first + corner * us.first + beside * us.second
        product[i + 1] = total.second + beside * us.first + last * us.second


@jit
def tridiagonalise(matrix, diagonal, off_diagonal, room):
    """Write the tridiagonal matrix that is similar to each symmetric one.

    Parameters
    ----------
    matrix : array (n n, LANES)
        The lower half is read; column k below the diagonal is overwritten by v of reflection k.
    diagonal, off_diagonal : array (n, LANES)
        Written, zero behind the n - 1 entries beside the diagonal.
    room : tuple of arrays (n, LANES)
        beta of all reflections, written, and room for v, w, the next v and a product.
    """
    n = diagonal.shape[0]
    betas, v, w, u, product = room
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
def reflect_four(rows, places, v, betas, k, n):
    """Multiply four rows, which begin at the places, by reflections k and k - 1, or by the first alone."""
    low, like = max(k - 1, 0), in_lanes(0.0)
    first = second = new_four(like, like, like, like)  # products with v_k and v_(k-1)
    both = like
    for i in range(k + 1, n):
        here, beside, x = v[i * n + k], v[i * n + low], four_of(rows, places, i)
        first, second, both = first + here * x, second + beside * x, both + here * beside
    first, start, x = betas[k] * first, v[k * n + low], four_of(rows, places, k)
    second = (like if k == 0 else betas[low]) * (second + start * x - both * first)
    put_four_of(rows, places, k, x - start * second)
    for i in range(k + 1, n):
        x = four_of(rows, places, i) - v[i * n + k] * first - v[i * n + low] * second
        put_four_of(rows, places, i, x)


@jit
def reflect_rows(matrix, betas, vectors):
    """Reflect n vectors back, each a row of `vectors` (n n, LANES), four at a time.

    Reflections k and k - 1 go through memory together; what would follow the last one is none.
    """
    n, like = betas.shape[0], in_lanes(0.0)
    rows, v, beta = view(vectors, like), view(matrix, like), view(betas, like)
    for r in range(0, n, 4):
        places = four_from(r, n, n - 1)
        for k in range(n - 3, -1, -2):
            reflect_four(rows, places, v, beta, k, n)


class StructureLanes(NamedTuple):
    """Eigenproblems of dense structures, one in each lane.

    Attributes
    ----------
    is_good : bool array (LANES,)
        Lanes that came out right; the others must be solved alone.
    theta : array (p, LANES)
    mass, stiffness, factor, reduced : array (n n, LANES)
        M and K, of which the lower half is written, the Cholesky factor of M, and A.
    diagonal, off_diagonal, work : array (n, LANES)
        Of the tridiagonal matrix, and what QL overwrites.
    values, rows : array (n, LANES), (n n, LANES)
        omega^2, ascending, and the mode shapes in rows.
    pivots, shape : array (2 n, LANES), (n, LANES)
    room : tuple of arrays
        See `tridiagonalise`.
    """

    is_good: np.ndarray
    theta: np.ndarray
    mass: np.ndarray
    stiffness: np.ndarray
    factor: np.ndarray
    reduced: np.ndarray
    diagonal: np.ndarray
    off_diagonal: np.ndarray
    work: np.ndarray
    values: np.ndarray
    rows: np.ndarray
    pivots: np.ndarray
    shape: np.ndarray
    room: tuple


@jit
def new_structures(n, n_theta):
    """Room for structures of n degrees of freedom."""
    room = new_vectors(n), new_vectors(n), new_vectors(n), new_vectors(n), new_vectors(n)
    return StructureLanes(
        is_good=np.zeros(LANES, dtype=np.bool_),
        theta=new_vectors(n_theta),
        mass=new_vectors(n * n),
        stiffness=new_vectors(n * n),
        factor=new_vectors(n * n),
        reduced=new_vectors(n * n),
        diagonal=new_vectors(n),
        off_diagonal=new_vectors(n),
        work=new_vectors(n),
        values=new_vectors(n),
        rows=new_vectors(n * n),
        pivots=new_vectors(2 * n),
        shape=new_vectors(n),
        room=room,
    )


@jit
def solve_structures(lanes, stacks, is_diagonal):
    """Write omega^2 and the mode shapes, and which lanes are good.

    Parameters
    ----------
    lanes : StructureLanes
        With theta.
    stacks : tuple of arrays (1 + p, n n) or (1, n n)
        Of M and K.
    is_diagonal : bool
        Whether M is diagonal.
    """
    n, (mass, stiffness) = lanes.diagonal.shape[0], stacks
    assemble_lanes(mass, lanes.theta, n, False, lanes.mass)
    assemble_lanes(stiffness, lanes.theta, n, False, lanes.stiffness)
    for e in range(n * n):
        store(lanes.factor, e, load(lanes.mass, e))
    factorise_lanes(lanes.factor, n, is_diagonal)
    standard_lanes(lanes.stiffness, lanes.factor, n, is_diagonal, lanes.reduced)
    tridiagonalise(lanes.reduced, lanes.diagonal, lanes.off_diagonal, lanes.room)
    room = lanes.work, lanes.pivots, lanes.shape
    converged = eigenvectors(lanes.diagonal, lanes.off_diagonal, lanes.values, lanes.rows, room)
    reflect_rows(lanes.reduced, lanes.room[0], lanes.rows)
    divide_rows(lanes.factor, n, is_diagonal, lanes.rows)
    largest = largest_values(lanes.values)
    for r in range(n):
        if highest(has_lost(load(lanes.values, r), largest)) > 0.0:
            improve_value(lanes, r, largest, is_diagonal)
    for lane in range(LANES):
        lanes.is_good[lane] = converged
        for r in range(n):  # NaN and infinity too
            lanes.is_good[lane] &= 0.0 <= lanes.values[r, lane] < np.inf
        if lanes.is_good[lane]:
            sort_modes(lanes, lane)


@jit
def sort_modes(lanes, lane):
    """Bring the modes of a lane into ascending order, which they have nearly always."""
    n = lanes.values.shape[0]
    is_in_order = True
    for r in range(1, n):
        is_in_order &= lanes.values[r - 1, lane] <= lanes.values[r, lane]
    if is_in_order:
        return
    order = np.empty(n, dtype=np.int64)
    positions(lanes.values, lane, order)
    values, rows = lanes.values[:, lane].copy(), lanes.rows[:, lane].copy()
    for r in range(n):
        lanes.values[r, lane] = values[order[r]]
        for i in range(n):
            lanes.rows[r * n + i, lane] = rows[order[r] * n + i]


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
        divide_rows(lanes.factor, n, is_diagonal, lanes.shape)
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
