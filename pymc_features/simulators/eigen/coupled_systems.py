"""Complex modes of many structures in the form in which tables are asked, see `mean_squares.systems`."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.complex_modes import new_complex
from pymc_features.simulators.eigen.coupled import (
    all_columns,
    check_damping,
    new_lanes,
    project,
    sort_modes,
    write_sensors,
)
from pymc_features.simulators.eigen.damping_matrices import filled_places, is_never_negative
from pymc_features.simulators.eigen.matrices import all_diagonal, assemble_lanes
from pymc_features.simulators.eigen.pairs import fill_lanes, new_oscillator_pairs, write_pairs
from pymc_features.simulators.eigen.structures import new_structures, solve_structures
from pymc_features.simulators.mean_squares.systems import put_modes
from pymc_features.simulators.oscillators.evaluation import new_walk
from pymc_features.simulators.oscillators.fast_modes import highest_coupled_step
from pymc_features.simulators.oscillators.modal_lanes import system_of
from pymc_features.simulators.oscillators.samples import of_population


@jit
def fill_systems(systems, parameters, excitation, wanted, observed):
    """Write the complex modes of all particles; where they do not come out right frequencies are NaN.

    Parameters as in `march_coupled`, and `systems` with twice as many modes as are wanted.
    """
    theta, (n_sensors, n), m = parameters.theta, wanted.sensors.shape, wanted.n_modes
    count, highest = theta.shape[0], highest_coupled_step(excitation) * excitation.substeps / excitation.dt
    columns, stacks = all_columns(parameters), (parameters.mass, parameters.stiffness)
    widths, step = of_population(), excitation.dt / excitation.substeps
    pairs, modes = new_oscillator_pairs(m, n_sensors), new_complex(m, n_sensors)
    walk = new_walk(excitation, np.empty((0, 0)), 1, 2 * m, n_sensors, widths)
    lot = new_lanes(parameters, wanted, m, walk.samples, step, widths)
    structures = new_structures(n, theta.shape[1], columns[0].shape[1])
    damping, room = new_vectors(n * n), new_vectors(m * n)
    places = filled_places(parameters.damping, n)
    is_safe = is_never_negative(parameters.damping, n)
    order = np.empty(n, dtype=np.int64)
    is_diagonal, support_motion = all_diagonal(parameters.mass, n), np.dot(wanted.sensors, columns[1])
    systems.valid[:], systems.omega[:] = True, np.nan
    for first in range(0, count, LANES):
        for lane in range(LANES):
            structures.theta[:, lane] = theta[min(first + lane, count - 1)]
        solve_structures(structures, stacks, is_diagonal, columns)
        for lane in range(LANES):
            modes.is_good[0, lane] = 1.0 if structures.is_good[lane] and first + lane < count else 0.0
        products = sort_modes(structures, modes, order)
        assemble_lanes(parameters.damping, structures.theta, n, True, damping)
        project(modes, damping, places, products, room)
        check_damping(modes, structures.factor, damping, highest, is_safe)
        write_sensors(modes, pairs.forced, products, wanted, support_motion)
        write_pairs(pairs, modes, n_sensors, wanted.quantity)
        fill_lanes(lot, pairs, modes.is_good)
        for lane in range(min(LANES, count - first)):
            if lot.is_there[lane]:
                system, feed = system_of(lot, lane)
                put_modes(systems, first + lane, system, feed)
