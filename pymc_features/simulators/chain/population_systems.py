"""Modes of many chains, for the tables of `mean_squares`."""

import numpy as np

from pymc_features.simulators.chain.parameters import own_rows
from pymc_features.simulators.chain.population import check_population
from pymc_features.simulators.chain.sensor_modes import new_sensor_modes, solve_at_sensors
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.filling import take_lane
from pymc_features.simulators.mean_squares.systems import new_systems, put_lane
from pymc_features.simulators.oscillators.fast_modes import highest_step
from pymc_features.simulators.oscillators.modal_system import DampingLaw


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
    n, steps = parameters.mass.shape[1], (excitation.dt / excitation.substeps, highest_step(excitation))
    systems, modes = new_systems(n_particles, sensors.size, m, 1, False), new_sensor_modes(n, sensors.size)
    kept, order = (new_vectors(m), new_vectors(m)), np.empty(n, dtype=np.int64)
    motion = np.ones(sensors.size)
    for first in range(0, n_particles, LANES):
        count = min(LANES, n_particles - first)
        solve_at_sensors(modes, parameters, sensors, first, count)
        for lane in range(count):
            own = own_rows(parameters, first + lane)
            law = DampingLaw(own.rayleigh, own.ratios)
            if modes.valid[lane] and take_lane(kept, lane, modes.values, law, steps, order):
                shapes = modes.vectors, order, lane
                put_lane(systems, first + lane, kept, shapes, (motion, quantity))
    return systems
