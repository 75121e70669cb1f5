"""Modes of many chains as the sensors have them: of the shapes only the rows that a discrepancy needs.

One chain is in each vector lane. With y = M^(1/2) phi, rows of the sensors and the participation phi' M 1 are
products of the eigenvectors y with s + 1 vectors.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.chain.parameters import own_rows
from pymc_features.simulators.chain.population_modes import write_chain
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
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.tridiagonal import (
    REACH,
    ROUNDS,
    SETTLED,
    diagonalise_lanes,
    has_lost,
    largest_values,
    twisted_vector,
)


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
