"""Dense structures with classical damping in compiled code: one of them, or a population under one input."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.linear.dense import assemble_dense, dense_modes, is_finite
from pymc_features.simulators.oscillators.lanes import new_lanes
from pymc_features.simulators.oscillators.modal_system import ModalSystem, write_feed
from pymc_features.simulators.oscillators.population import lane_statistics, put_system
from pymc_features.simulators.oscillators.recursion import march_modes, statistics, write_damping


@jit
def dense_system(parameters, theta, law, wanted, step):
    """Modes of one structure, as the outputs have them.

    Parameters
    ----------
    parameters : LinearParameters
        For the matrices, dense.
    theta : array (p,)
    law : tuple of arrays (2,), (k,)
        rayleigh and ratios.
    wanted : Outputs
    step : float
        Step of the recursion [s].

    Returns
    -------
    valid : bool
        False if there is no structure; the rest is undefined then.
    system : ModalSystem
    feed : array (s, d)
        Feed-through of the inputs.
    """
    n, m = parameters.influence.shape[0], wanted.n_modes
    influence, forces, (rayleigh, ratios) = parameters.influence, parameters.forces, law
    mass, stiffness = np.empty((n, n)), np.empty((n, n))
    omega, damping, rows = np.empty(m), np.empty(m), np.zeros((m, n))
    valid = is_finite(theta) and is_finite(rayleigh) and is_finite(ratios)
    if valid:
        assemble_dense(parameters.mass, theta, mass)
        assemble_dense(parameters.stiffness, theta, stiffness)
        valid = dense_modes(mass, stiffness, omega, rows)
    if valid:
        valid = write_damping(omega, rayleigh, ratios, step, damping)
    participation = np.dot(rows, np.dot(mass, influence) - forces)
    system = ModalSystem(omega, damping, np.dot(wanted.sensors, rows.T), participation)
    support_motion = np.dot(wanted.sensors, influence)
    feed = np.empty(support_motion.shape)
    if valid:
        write_feed(system, np.dot(rows, forces), support_motion, wanted.quantity, m == n, feed)
    return valid, system, feed


@jit
def march_structure(parameters, excitation, wanted, observed, history):
    """Statistics (s, 4) of the misfit of one structure; the response, in the `history` unless it is empty.

    NaN where the parameters describe no structure.
    """
    law, sums = (parameters.rayleigh, parameters.ratios), np.zeros((4, wanted.sensors.shape[0]))
    step = excitation.dt / excitation.substeps
    valid, system, feed = dense_system(parameters, parameters.theta, law, wanted, step)
    if valid:
        march_modes(system, feed, excitation, wanted.quantity, observed, history, sums)
    else:
        history[:], sums[:] = np.nan, np.nan
    return statistics(sums, observed.shape[1])


@jit
def march_dense(parameters, excitation, wanted, observed, increments):
    """Misfits of all particles, the modes found one by one and the recursion run for `LANES` at once.

    Parameters
    ----------
    parameters : LinearParameters
        theta, rayleigh and ratios (p or 1, ...) have a row for each particle or one for all.
    excitation : Excitation
        With one input (1, t).
    wanted : Outputs
    observed : array (s, u)
        Data.
    increments : Increments or None
        None if only e_j is asked for.

    Returns
    -------
    array (p, s, 1), or (p, s, 4) with increments
        NaN in the rows whose parameters describe no structure.
    """
    theta, rayleigh, ratios = parameters.theta, parameters.rayleigh, parameters.ratios
    n_sensors, step = wanted.sensors.shape[0], excitation.dt / excitation.substeps
    count = max(theta.shape[0], rayleigh.shape[0], ratios.shape[0])
    result = np.full((count, n_sensors, 1 if increments is None else 4), np.nan)
    lanes, places = new_lanes(n_sensors, wanted.n_modes, excitation.stride), np.empty(LANES, dtype=np.int64)
    waiting = 0
    for p in range(count):
        law = rayleigh[p % rayleigh.shape[0]], ratios[p % ratios.shape[0]]
        valid, system, feed = dense_system(parameters, theta[p % theta.shape[0]], law, wanted, step)
        if valid:
            put_system(lanes, waiting, system, feed[:, 0].copy(), excitation, wanted.quantity)
            places[waiting] = p
            waiting += 1
        if waiting == LANES or (waiting > 0 and p == count - 1):
            found = lane_statistics(lanes, excitation, observed, increments)
            for lane in range(waiting):
                result[places[lane]] = found[lane]
            waiting = 0
    return result
