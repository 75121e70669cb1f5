"""Modes of many dense structures, one in each vector lane: frequencies, and the shapes times vectors.

Householder's reflections and QL turn only the vectors that are asked for: rows of the sensors, the load, the
forces. Frequencies far below the largest get their digits back from Rayleigh quotients. What lanes cannot do,
masses that are zero and frequencies that may be imaginary, is left to whoever solves one structure at a time.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.algebra import ROUNDING
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, highest, load, magnitude, splat, store, where_less
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.matrices import (
    assemble_lanes,
    divide_columns,
    divide_rows,
    divide_transposed,
    energy_lanes,
    factorise_lanes,
    standard_lanes,
)
from pymc_features.simulators.eigen.reflections import reflect_back, reflect_rows, tridiagonalise
from pymc_features.simulators.eigen.root_free import values_of_lanes
from pymc_features.simulators.eigen.tridiagonal import (
    REACH,
    ROUNDS,
    SETTLED,
    are_apart,
    diagonalise_lanes,
    has_lost,
    largest_values,
    twisted_vector,
    whole_vectors,
)


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
