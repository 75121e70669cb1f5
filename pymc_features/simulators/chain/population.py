"""Misfits of many chains at once; see `oscillators.population` for how."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.chain.parameters import own_rows
from pymc_features.simulators.chain.population_modes import fill_matrix, normalise_lanes
from pymc_features.simulators.chain.response import check_history, check_sizes
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, load, store
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.tridiagonal import are_apart, diagonalise_lanes, whole_vectors


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
def check_population(parameters, excitation, wanted, observed):
    """Refuse inputs whose sizes do not agree; return the number of particles."""
    check_sizes(own_rows(parameters, 0), wanted)
    check_history(observed, excitation, wanted)
    mass, stiffness, rayleigh, ratios = parameters
    n_particles = max(mass.shape[0], stiffness.shape[0], rayleigh.shape[0], ratios.shape[0])
    for size in (mass.shape[0], stiffness.shape[0], rayleigh.shape[0], ratios.shape[0]):
        if size != 1 and size != n_particles:
            raise ValueError(
                "`mass`, `stiffness`, `rayleigh` and `ratios` must have one row, or one for each particle"
            )
    return n_particles


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
