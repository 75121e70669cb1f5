"""Modes of many chains, for the tables of `mean_squares`."""

import numpy as np

from pymc_features.simulators.chain.parameters import own_rows
from pymc_features.simulators.chain.population import check_population, new_modes, solve_modes
from pymc_features.simulators.chain.population_modes import take_modes
from pymc_features.simulators.chain.response import chain_feed, write_shapes
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.mean_squares.systems import new_systems, put_modes
from pymc_features.simulators.oscillators.modal_system import ModalSystem
from pymc_features.simulators.oscillators.recursion import write_damping


@jit
def chain_systems(parameters, excitation, wanted, observed):
    """`Systems` of all particles.

    Parameters
    ----------
    parameters, excitation, wanted, observed
        As of `population.population_discrepancy`; of the data their shape.
    """
    n_particles = check_population(parameters, excitation, wanted, observed)
    sensors, m, quantity = wanted
    n, step = parameters.mass.shape[1], excitation.dt / excitation.substeps
    systems, modes = new_systems(n_particles, sensors.size, m, 1), new_modes(n)
    omega, damping, participation = np.empty(n), np.empty(m), np.empty(n)
    rows, shapes = np.empty((n, n)), np.empty((sensors.size, m))
    for first in range(0, n_particles, LANES):
        count = min(LANES, n_particles - first)
        solve_modes(modes, parameters, first, count)
        for lane in range(count):
            own = own_rows(parameters, first + lane)
            take_modes(modes, lane, omega, participation, rows)
            if modes.valid[lane] and write_damping(omega[:m], own.rayleigh, own.ratios, step, damping):
                write_shapes(rows, sensors, shapes)
                system = ModalSystem(omega[:m], damping, shapes, participation[:m].reshape(m, 1))
                put_modes(systems, first + lane, system, chain_feed(system, wanted, m == n))
    return systems
