"""Modes of many chains at once, one in each vector lane; those of `modes.chain_modes` up to rounding.

Modes of many chains as the sensors have them: of the shapes only the rows that a discrepancy needs.

One chain is in each vector lane. With y = M^(1/2) phi, rows of the sensors and the participation phi' M 1 are
products of the eigenvectors y with s + 1 vectors.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.chain.modes import is_chain, is_graded
from pymc_features.simulators.chain.parameters import own_rows
from pymc_features.simulators.compiled.arrays import ascending
from pymc_features.simulators.compiled.jit import jit
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
from pymc_features.simulators.numbers.compiled_numbers import highest, magnitude, square_root, where_less
from pymc_features.simulators.numbers.vectors import LANES, load, new_vectors, splat, store


@jit
def write_chain(chains, lane, mass, stiffness):
    """Write one chain and its symmetric tridiagonal matrix into a lane.

    Parameters
    ----------
    chains : tuple of arrays (n, LANES)
        Masses, springs, diagonal and off-diagonal.
    mass, stiffness : array (n,)

    Returns
    -------
    bool
        False, and the matrix is zero, where the parameters do not describe a chain.
    """
    masses, springs, diagonal, off_diagonal = chains
    n, possible = mass.size, is_chain(mass, stiffness) and not is_graded(stiffness)
    for i in range(n):
        masses[i, lane], springs[i, lane] = mass[i], stiffness[i]
        above = stiffness[i + 1] if i + 1 < n else 0.0
        diagonal[i, lane] = (stiffness[i] + above) / mass[i]
        off_diagonal[i, lane] = -above / (np.sqrt(mass[i]) * np.sqrt(mass[i + 1])) if i + 1 < n else 0.0
        possible &= diagonal[i, lane] < np.inf and off_diagonal[i, lane] > -np.inf
    if not possible:
        for i in range(n):
            diagonal[i, lane] = off_diagonal[i, lane] = 0.0
    return possible


@jit
def fill_matrix(modes, lane, mass, stiffness):
    """Write one chain, its matrix, and the identity, into a lane of `ModeLanes`; returns as `write_chain`."""
    for i in range(mass.size):
        modes.vectors[i * mass.size + i, lane] = 1.0
    chains = modes.mass, modes.stiffness, modes.frequencies, modes.off_diagonal
    return write_chain(chains, lane, mass, stiffness)


@jit
def normalise_lanes(modes):
    """Turn eigenvectors into mode shapes in place: `modes.normalise` for all lanes.

    The frequencies and participation factors of `ModeLanes` are written, the off-diagonal overwritten.
    """
    _, masses, springs, frequencies, participation, work, vectors = modes
    n = masses.shape[0]
    zero, one = splat(0.0), splat(1.0)
    for i in range(n):
        store(work, i, one / square_root(load(masses, i)))
    for r in range(n):
        energy, inertia, below = zero, zero, zero
        for i in range(n):
            mass = load(masses, i)
            shape = load(vectors, r * n + i) * load(work, i)
            store(vectors, r * n + i, shape)
            drift = shape - below
            energy = energy + load(springs, i) * drift * drift
            inertia = inertia + mass * shape * shape
            below = shape
        scale = where_less(below, zero, zero - one, one) / square_root(inertia)
        total = zero
        for i in range(n):
            shape = load(vectors, r * n + i) * scale
            store(vectors, r * n + i, shape)
            total = total + load(masses, i) * shape
        store(frequencies, r, square_root(energy / inertia))
        store(participation, r, total)


@jit
def take_modes(modes, lane, omega, participation, rows):
    """Copy the modes of one lane of `ModeLanes` out of it, in ascending order of frequency."""
    n = omega.size
    order = ascending(modes.frequencies[:, lane])
    for r in range(n):
        omega[r] = modes.frequencies[order[r], lane]
        participation[r] = modes.participation[order[r], lane]
        for i in range(n):
            rows[r, i] = modes.vectors[order[r] * n + i, lane]


class ModeLanes(NamedTuple):
    """Eigenproblems of chains, one in each lane.

    Attributes
    ----------
    valid : bool array (LANES,)
        Which lanes have a chain.
    mass, stiffness, frequencies, participation, off_diagonal : array (n, LANES)
    vectors : array (n n, LANES)
    """

    valid: np.ndarray
    mass: np.ndarray
    stiffness: np.ndarray
    frequencies: np.ndarray
    participation: np.ndarray
    off_diagonal: np.ndarray
    vectors: np.ndarray


@jit
def new_modes(n):
    """Room for the eigenproblems of chains of n masses."""
    mass, stiffness, frequencies = new_vectors(n), new_vectors(n), new_vectors(n)
    participation, off_diagonal = new_vectors(n), new_vectors(n)
    valid, vectors = np.empty(LANES, dtype=np.bool_), new_vectors(n * n)
    return ModeLanes(valid, mass, stiffness, frequencies, participation, off_diagonal, vectors)


@jit
def solve_modes(modes, parameters, first, count):
    """Solve the eigenproblems of particles `first` ... `first + count - 1` together."""
    valid, mass, stiffness, frequencies, participation, off_diagonal, vectors = modes
    for array in (mass, stiffness, frequencies, participation, off_diagonal, vectors):
        array.fill(0.0)
    valid.fill(False)
    for lane in range(count):
        own = own_rows(parameters, first + lane)
        valid[lane] = fill_matrix(modes, lane, own.mass, own.stiffness)
    if not find_vectors(modes):
        valid.fill(False)
    normalise_lanes(modes)


@jit
def find_vectors(modes):
    """Overwrite the diagonals by eigenvalues, and write the vectors; False if that fails."""
    n, vectors = modes.frequencies.shape[0], modes.vectors
    values, work = new_vectors(n), new_vectors(n)
    for turn in range(2):  # without vectors first: they are found one by one where no eigenvalues are close
        for i in range(n):
            store(values, i, load(modes.frequencies, i))
            store(work, i, load(modes.off_diagonal, i))
        if not diagonalise_lanes(values, work, vectors if turn == 1 else vectors[:0]):
            return False
        if turn == 0 and are_apart(values):
            pivots = new_vectors(2 * n)
            whole_vectors(modes.frequencies, modes.off_diagonal, values, pivots, work, vectors)
            break
    for i in range(n):
        store(modes.frequencies, i, load(values, i))
    return True


class SensorModes(NamedTuple):
    """Eigenproblems of chains, one in each lane.

    Attributes
    ----------
    valid : bool array (LANES,)
        Which lanes have a chain.
    mass, stiffness, diagonal, off_diagonal : array (n, LANES)
        Of the chains and their tridiagonal matrices.
    values, work : array (n, LANES)
        omega^2, and what QL overwrites.
    vectors : array (n (s + 1), LANES)
        phi of each mode at the sensors, then its participation.
    pivots, shape : array (2 n, LANES), (n, LANES)
        Room for one mode shape.
    """

    valid: np.ndarray
    mass: np.ndarray
    stiffness: np.ndarray
    diagonal: np.ndarray
    off_diagonal: np.ndarray
    values: np.ndarray
    work: np.ndarray
    vectors: np.ndarray
    pivots: np.ndarray
    shape: np.ndarray


@jit
def new_sensor_modes(n, n_sensors):
    """Room for chains of n masses."""
    return SensorModes(
        valid=np.empty(LANES, dtype=np.bool_),
        mass=np.ones((n, LANES)),
        stiffness=np.ones((n, LANES)),
        diagonal=new_vectors(n),
        off_diagonal=new_vectors(n),
        values=new_vectors(n),
        work=new_vectors(n),
        vectors=new_vectors(n * (n_sensors + 1)),
        pivots=new_vectors(2 * n),
        shape=new_vectors(n),
    )


@jit
def solve_at_sensors(modes, parameters, sensors, first, count):
    """Solve the eigenproblems of particles `first` ... `first + count - 1` together."""
    n, width = modes.mass.shape[0], sensors.size + 1
    chains = modes.mass, modes.stiffness, modes.diagonal, modes.off_diagonal
    modes.valid.fill(False)
    for lane in range(count):
        own = own_rows(parameters, first + lane)
        modes.valid[lane] = write_chain(chains, lane, own.mass, own.stiffness)
    modes.vectors.fill(0.0)
    for i in range(n):
        store(modes.values, i, load(modes.diagonal, i))
        store(modes.work, i, load(modes.off_diagonal, i))
        store(modes.vectors, i * width + sensors.size, square_root(load(modes.mass, i)))
    for j in range(sensors.size):
        row = sensors[j] * width + j
        store(modes.vectors, row, splat(1.0) / square_root(load(modes.mass, sensors[j])))
    if not diagonalise_lanes(modes.values, modes.work, modes.vectors):
        modes.valid.fill(False)
    largest = largest_values(modes.values)
    for r in range(n):
        if highest(has_lost(load(modes.values, r), largest)) > 0.0:
            improve_value(modes, r, largest)


@jit
def improve_value(modes, r, largest):
    """Replace omega_r^2 in the lanes where it lost digits by the Rayleigh quotient of its shape.

    In springs that is a sum of non-negative energies, right to the last digits whatever the others are.
    """
    found = load(modes.values, r)
    value, lost = found, has_lost(found, largest)
    moving = lost  # a lane that has settled stays: its number is not to depend on its neighbours
    for _ in range(ROUNDS):
        twisted_vector(modes.diagonal, modes.off_diagonal, value, modes.pivots, modes.shape)
        energy = inertia = below = splat(0.0)
        for i in range(modes.mass.shape[0]):
            y = load(modes.shape, i)
            shape = y / square_root(load(modes.mass, i))
            drift = shape - below
            energy = energy + load(modes.stiffness, i) * drift * drift
            inertia = inertia + y * y
            below = shape
        quotient = energy / inertia
        change = magnitude(quotient - value) - SETTLED * quotient
        value = where_less(splat(0.0), moving, quotient, value)
        moving = where_less(splat(0.0), moving, change, splat(-1.0))
        if not highest(moving) > 0.0:
            break
    near = where_less(magnitude(value - found), REACH * largest, value, found)
    store(modes.values, r, where_less(splat(0.0), lost, near, found))
