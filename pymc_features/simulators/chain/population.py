"""Mean-square discrepancies of many sets of parameters at once; see `recursion_lanes.py` for how."""

import numpy as np

from pymc_features.simulators.chain.population_modes import (
    diagonalise_lanes,
    fill_lane,
    normalise_lanes,
    take_lane,
)
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.oscillators.arguments import n_outputs
from pymc_features.simulators.oscillators.population_recursion import (
    N_COEFFICIENTS,
    SAMPLES,
    fill_recursion,
    march,
    take_sums,
)
from pymc_features.simulators.oscillators.recursion import N_ROWS, check_sizes, modal_coefficients


@jit
def check_population(mass, stiffness, rayleigh, ratios, sensors, n_modes, n_times, observed):
    """Refuse inputs whose sizes do not agree; return the number of particles."""
    check_sizes(mass[0], stiffness[0], rayleigh[0], ratios[0], sensors, n_modes)
    if observed.shape[0] != sensors.size or observed.shape[1] != n_times:
        raise ValueError("`observed` must have the shape (sensor, time) of the response")
    n_particles = max(mass.shape[0], stiffness.shape[0], rayleigh.shape[0], ratios.shape[0])
    for size in (mass.shape[0], stiffness.shape[0], rayleigh.shape[0], ratios.shape[0]):
        if size != 1 and size != n_particles:
            raise ValueError(
                "`mass`, `stiffness`, `rayleigh` and `ratios` must have one row, or one for each particle"
            )
    return n_particles


@jit
def group_modes(mass, stiffness, first, count, valid, lanes):
    """Solve the eigenproblems of `count` particles together; `valid` (LANES,) says which there are.

    `lanes` are arrays for masses, springs, frequencies, participation, off_diagonal (n, LANES) and vectors
    (n n, LANES).
    """
    masses, springs, frequencies, participation, off_diagonal, vectors = lanes
    for array in lanes:
        array.fill(0.0)
    for lane in range(count):
        p = first + lane
        lane_mass, lane_stiffness = mass[p % mass.shape[0]], stiffness[p % stiffness.shape[0]]
        valid[lane] = fill_lane(
            lane_mass, lane_stiffness, lane, masses, springs, frequencies, off_diagonal, vectors
        )
    if not diagonalise_lanes(frequencies, off_diagonal, vectors):
        valid.fill(False)
    normalise_lanes(masses, springs, frequencies, participation, off_diagonal, vectors)


@jit
def fill_group(
    parameters, step, sensors, quantity, start, first, count, modes, coefficients, states, shapes, direct
):
    """Write what the recursion needs for `count` particles into their lanes.

    Parameters
    ----------
    parameters : tuple of arrays
        mass, stiffness, rayleigh, ratios.
    modes : tuple of arrays
        Work space: valid (LANES,), lanes as in `group_modes`, and for one particle omega, participation
        (n,), mode_shapes (n, n), table (11, m), shapes and direct.
    coefficients, states, shapes, direct : array (..., LANES)
        Written.
    """
    mass, stiffness, rayleigh, ratios = parameters
    valid, lanes, omega, participation, mode_shapes, table, own, own_direct = modes
    _, _, frequencies, participations, _, vectors = lanes
    for array in (coefficients, states, shapes, direct):
        array.fill(0.0)
    group_modes(mass, stiffness, first, count, valid, lanes)
    for lane in range(count):
        p = first + lane
        if not valid[lane]:
            continue
        take_lane(lane, frequencies, participations, vectors, omega, participation, mode_shapes)
        valid[lane] = modal_coefficients(
            omega,
            mode_shapes,
            participation,
            rayleigh[p % rayleigh.shape[0]],
            ratios[p % ratios.shape[0]],
            step,
            sensors,
            quantity,
            table,
            own,
            own_direct,
        )
        if valid[lane]:
            fill_recursion(table, own, own_direct, start, lane, coefficients, states, shapes, direct)


@jit
def march_population(
    parameters, acceleration, dt, substeps, stride, sensors, n_modes, quantity, observed, misfits, chained
):
    """Sums over the samples for all particles, a vector of them at a time.

    Parameters
    ----------
    parameters : tuple of arrays
        mass, stiffness, rayleigh, ratios.
    misfits, chained
        As in `recursion_lanes.march`.

    Returns
    -------
    array (p, s, 1), or (p, s, 4) unless `misfits` is None
        Mean squares of the misfit and of its increments, its first and its last value. NaN in the rows whose
        parameters describe no structure.
    """
    mass, stiffness, rayleigh, ratios = parameters
    n_sensors, n = sensors.size, mass.shape[1]
    n_times = n_outputs(acceleration.size, substeps, stride)
    n_particles = check_population(mass, stiffness, rayleigh, ratios, sensors, n_modes, n_times, observed)
    even_sensors, even_modes = n_sensors + n_sensors % 2, n_modes + n_modes % 2
    result = np.empty((n_particles, n_sensors, 1 if misfits is None else 4))
    coefficients = np.empty((N_COEFFICIENTS * even_modes, LANES))
    states = np.empty((2 * even_modes, LANES))
    shapes = np.empty((even_sensors * even_modes, LANES))
    direct, errors = np.empty((even_sensors, LANES)), np.empty((even_sensors, LANES))
    valid = np.empty(LANES, dtype=np.bool_)
    modes = (
        valid,
        (
            *(np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n, LANES))),
            *(np.empty((n, LANES)), np.empty((n * n, LANES))),
        ),
        *(np.empty(n), np.empty(n), np.empty((n, n))),
        *(np.empty((N_ROWS, n_modes)), np.empty((n_sensors, n_modes)), np.empty(n_sensors)),
    )
    outputs, ground = np.empty((SAMPLES * even_modes, LANES)), np.empty(SAMPLES * stride)
    work = (outputs, ground, np.empty((n_sensors, SAMPLES)))
    step, start = dt / substeps, acceleration[0]
    for first in range(0, n_particles, LANES):
        count = min(LANES, n_particles - first)
        fill_group(
            *(parameters, step, sensors, quantity, start, first, count, modes),
            *(coefficients, states, shapes, direct),
        )
        march(
            *(coefficients, states, shapes, direct, acceleration, substeps, stride, observed, errors, work),
            *(misfits, chained),
        )
        take_sums(errors, misfits, chained, n_times, result[first : first + count])
        for lane in range(count):
            if not valid[lane]:
                result[first + lane] = np.nan
    return result


@jit
def population_discrepancy(parameters, excitation, wanted, observed):
    """e_j of Eq. (3) for a population of spring-mass chains.

    Parameters
    ----------
    mass, stiffness, ratios : array (p or 1, n)
        One row for each particle, or one for all; units as in `recursion.modal_system`.
    rayleigh : array (p or 1, 2)
        alpha [1/s] and beta [s].
    acceleration, dt, substeps, stride, sensors, n_modes, quantity, observed
        Common to all, as in `discrepancy.chain_discrepancy`.

    Returns
    -------
    array (p, s)
        NaN in the rows whose parameters describe no structure.

    Notes
    -----
    One thread. Memory: the result and one block of 16 samples for 4 or 8 particles, whatever the length of
    the record and the number of particles. Agrees with `chain_discrepancy` to 1e-12.
    """
    mass, stiffness, rayleigh, ratios = parameters
    acceleration, dt, substeps, stride = excitation
    sensors, n_modes, quantity = wanted
    result = march_population(
        *((mass, stiffness, rayleigh, ratios), acceleration, dt, substeps, stride),
        *(sensors, n_modes, quantity, observed, None, None),
    )
    return result[:, :, 0].copy()


@jit
def population_misfit(parameters, excitation, wanted, observed):
    """What `discrepancy.chain_misfit` returns, for a population: an array (p, s, 4).

    Parameters and cost in memory as those of `population_discrepancy`.
    """
    mass, stiffness, rayleigh, ratios = parameters
    acceleration, dt, substeps, stride = excitation
    sensors, n_modes, quantity = wanted
    even_sensors = sensors.size + sensors.size % 2
    chained = (
        *(np.empty((even_sensors, LANES)), np.empty((even_sensors, LANES))),
        np.empty((even_sensors, LANES)),
    )
    return march_population(
        *((mass, stiffness, rayleigh, ratios), acceleration, dt, substeps, stride),
        *(sensors, n_modes, quantity, observed, np.empty((even_sensors * SAMPLES, LANES)), chained),
    )
