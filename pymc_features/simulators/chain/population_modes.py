"""Modes of many chains at once, one in each vector lane; those of `modes.chain_modes` up to rounding."""

import numpy as np

from pymc_features.simulators.chain.modes import is_chain, is_graded
from pymc_features.simulators.compiled.arrays import ascending
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import load, splat, square_root, store, where_less


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
