"""Misfits of many chains at once; see `oscillators.population` for how."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.chain.parameters import own_rows
from pymc_features.simulators.chain.population_modes import fill_matrix, normalise_lanes
from pymc_features.simulators.chain.response import check_history, check_sizes, compare
from pymc_features.simulators.chain.sensor_modes import new_sensor_modes, solve_at_sensors
from pymc_features.simulators.compiled.jit import inline, jit
from pymc_features.simulators.compiled.vector import LANES, load, store
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.filling import empty_modes, fill_lanes, take_lane
from pymc_features.simulators.eigen.tridiagonal import are_apart, diagonalise_lanes, whole_vectors
from pymc_features.simulators.oscillators.arguments import at_every_step
from pymc_features.simulators.oscillators.fast_modes import highest_step
from pymc_features.simulators.oscillators.lanes import new_increments, new_lanes
from pymc_features.simulators.oscillators.modal_system import DampingLaw, feed_through
from pymc_features.simulators.oscillators.population import lane_statistics


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


@jit
def write_outputs(lanes, lane, vectors, order, n_modes, quantity):
    """Write what the modes of one chain, in their order, do at the sensors, and the feed-through.

    `vectors` are those of `SensorModes`.
    """
    n, even_modes = order.size, lanes.states.shape[0] // 2
    width = vectors.shape[0] // n
    for j in range(width - 1):
        by_modes = 0.0
        for r in range(n_modes):
            row = order[r] * width
            share = vectors[row + j, lane] * vectors[row + width - 1, lane]
            lanes.shapes[j * even_modes + r, lane] = share
            by_modes += share
        feed = feed_through(1.0, 0.0, by_modes, quantity, n_modes == n)
        lanes.feed[j, lane], lanes.direct[j, lane] = feed, feed


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
    n, sensors, quantity = parameters.mass.shape[1], wanted.sensors, wanted.quantity
    motion, m = at_every_step(excitation), wanted.n_modes
    steps, start = (motion.dt, highest_step(excitation)), motion.acceleration[0]
    result = np.empty((n_particles, sensors.size, 1 if increments is None else 4))
    lanes, modes = new_lanes(observed, m, motion, False), new_sensor_modes(n, sensors.size)
    kept, order = (new_vectors(m), new_vectors(m)), np.empty(n, dtype=np.int64)
    for first in range(0, n_particles, LANES):
        count = min(LANES, n_particles - first)
        solve_at_sensors(modes, parameters, sensors, first, count)
        for lane in range(LANES):
            if modes.valid[lane]:
                own = own_rows(parameters, first + lane)
                law = DampingLaw(own.rayleigh, own.ratios)
                modes.valid[lane] = take_lane(kept, lane, modes.values, law, steps, order)
            if modes.valid[lane]:
                write_outputs(lanes, lane, modes.vectors, order, m, quantity)
            else:
                empty_modes(kept, lane)
        fill_lanes(lanes, kept, motion.dt, quantity, start)
        found = lane_statistics(lanes, motion, observed, increments)
        for lane in range(count):  # Numba takes three seconds to compile a copy of a slice
            one = found[lane]
            if not modes.valid[lane]:  # no structure, or one with modes that follow
                own = own_rows(parameters, first + lane)
                one = compare(own, excitation, wanted, observed, result.shape[2])
            for j in range(sensors.size):
                for i in range(result.shape[2]):
                    result[first + lane, j, i] = one[j, i]
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
