"""Misfits of many chains at once; see `oscillators.population` for how."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.chain.parameters import own_rows
from pymc_features.simulators.chain.population_modes import (
    diagonalise_lanes,
    fill_matrix,
    normalise_lanes,
    take_modes,
)
from pymc_features.simulators.chain.response import check_history, check_sizes, write_feed, write_shapes
from pymc_features.simulators.compiled.jit import inline, jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.oscillators.lanes import new_increments, new_lanes
from pymc_features.simulators.oscillators.modal_system import ModalSystem
from pymc_features.simulators.oscillators.population import fill_lane, lane_statistics
from pymc_features.simulators.oscillators.recursion import N_ROWS, write_damping, write_table


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
    mass, stiffness, frequencies = np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n, LANES))
    participation, off_diagonal = np.empty((n, LANES)), np.empty((n, LANES))
    valid, vectors = np.empty(LANES, dtype=np.bool_), np.empty((n * n, LANES))
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
    if not diagonalise_lanes(frequencies, off_diagonal, vectors):
        valid.fill(False)
    normalise_lanes(modes)


@inline
def march_population(parameters, excitation, wanted, observed, increments):
    """Statistics of the misfit of all particles, a vector of them at a time.

    Parameters
    ----------
    parameters : ChainParameters
        Each array has a row for each particle, or one for all.
    excitation, wanted, observed
        Common to all, as in `response.chain_misfit`.
    increments : Increments or None

    Returns
    -------
    array (p, s, 1), or (p, s, 4) with increments
        NaN in the rows whose parameters describe no structure.
    """
    n_particles = check_population(parameters, excitation, wanted, observed)
    sensors, m, quantity = wanted
    n, step = parameters.mass.shape[1], excitation.dt / excitation.substeps
    result = np.empty((n_particles, sensors.size, 1 if increments is None else 4))
    lanes, modes = new_lanes(observed, m, excitation.stride), new_modes(n)
    omega, damping, table = np.empty(n), np.empty(m), np.empty((N_ROWS, m))
    participation, rows = np.empty(n), np.empty((n, n))
    shapes, feed = np.empty((sensors.size, m)), np.empty(sensors.size)
    system = ModalSystem(omega[:m], damping, shapes, participation[:m].reshape(m, 1))
    for first in range(0, n_particles, LANES):
        count = min(LANES, n_particles - first)
        solve_modes(modes, parameters, first, count)
        for lane in range(count):
            if not modes.valid[lane]:
                continue
            own = own_rows(parameters, first + lane)
            take_modes(modes, lane, omega, participation, rows)
            modes.valid[lane] = write_damping(system.omega, own.rayleigh, own.ratios, step, damping)
            if modes.valid[lane]:
                write_shapes(rows, sensors, shapes)
                write_table(system.omega, damping, step, quantity, table)
                write_feed(system, quantity, m == n, feed)
                fill_lane(lanes, lane, table, system, feed, excitation.acceleration[0])
        found = lane_statistics(lanes, excitation, observed, increments)
        for lane in range(count):
            result[first + lane] = found[lane]
            if not modes.valid[lane]:
                result[first + lane] = np.nan
    return result


@jit
def population_discrepancy(parameters, excitation, wanted, observed):
    """e_j (p, s) of Eq. (3) for a population; NaN in the rows whose parameters describe no structure.

    Parameters
    ----------
    parameters : ChainParameters
        Each array has a row for each particle, or one for all.
    excitation, wanted, observed
        Common to all, as in `response.chain_discrepancy`.

    Notes
    -----
    One thread. Memory: the result and one block of 16 samples for 4 or 8 particles, whatever the length of
    the record and the number of particles. Agrees with `chain_discrepancy` to 1e-12.
    """
    return march_population(parameters, excitation, wanted, observed, None)[:, :, 0].copy()


@jit
def population_misfit(parameters, excitation, wanted, observed):
    """What `response.chain_misfit` returns, for a population: an array (p, s, 4)."""
    increments = new_increments(wanted.sensors.size)
    return march_population(parameters, excitation, wanted, observed, increments)
