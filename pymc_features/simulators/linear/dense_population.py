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
def solve_dense(parameters, own, step, n_modes, n_kept):
    """Lowest modes of one structure, with the damping of those that are kept.

    Parameters
    ----------
    parameters : LinearParameters
        For the matrices, dense.
    own : tuple of arrays (p,), (2,), (k,)
        theta, rayleigh and ratios.
    step : float
        Step of the recursion [s].
    n_modes, n_kept : int

    Returns
    -------
    valid : bool
        False if there is no structure; the rest is undefined then.
    omega, rows : array (n_modes,), (n_modes, n)
        As `dense_modes` writes them.
    damping : array (n_kept,)
        D [1/s].
    load : array (n, d)
        M influence - forces.
    """
    n, (theta, rayleigh, ratios) = parameters.influence.shape[0], own
    mass, stiffness = np.empty((n, n)), np.empty((n, n))
    omega, damping, rows = np.empty(n_modes), np.empty(n_kept), np.zeros((n_modes, n))
    valid = is_finite(theta) and is_finite(rayleigh) and is_finite(ratios)
    if valid:
        assemble_dense(parameters.mass, theta, mass)
        assemble_dense(parameters.stiffness, theta, stiffness)
        valid = dense_modes(mass, stiffness, omega, rows)
    if valid:
        valid = write_damping(omega[:n_kept], rayleigh, ratios, step, damping)
    return valid, omega, rows, damping, np.dot(mass, parameters.influence) - parameters.forces


@jit
def dense_system(parameters, own, wanted, step):
    """Modes of one structure, as the outputs have them.

    Parameters
    ----------
    parameters, own, step
        As of `solve_dense`.
    wanted : Outputs

    Returns
    -------
    valid : bool
        False if there is no structure; the rest is undefined then.
    system : ModalSystem
    feed : array (s, d)
        Feed-through of the inputs.
    """
    influence, forces, m = parameters.influence, parameters.forces, wanted.n_modes
    valid, omega, rows, damping, load = solve_dense(parameters, own, step, m, m)
    system = ModalSystem(omega, damping, np.dot(wanted.sensors, rows.T), np.dot(rows, load))
    support_motion = np.dot(wanted.sensors, influence)
    feed = np.empty(support_motion.shape)
    if valid:
        complete = m == influence.shape[0]
        write_feed(system, np.dot(rows, forces), support_motion, wanted.quantity, complete, feed)
    return valid, system, feed


@jit
def march_structure(parameters, excitation, wanted, observed, history):
    """Statistics (s, 4) of the misfit of one structure; the response, in the `history` unless it is empty.

    NaN where the parameters describe no structure.
    """
    own, sums = (
        (parameters.theta, parameters.rayleigh, parameters.ratios),
        np.zeros((4, wanted.sensors.shape[0])),
    )
    valid, system, feed = dense_system(parameters, own, wanted, excitation.dt / excitation.substeps)
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
    lanes, places = new_lanes(observed, wanted.n_modes, excitation.stride), np.empty(LANES, dtype=np.int64)
    waiting = 0
    for p in range(count):
        own = theta[p % theta.shape[0]], rayleigh[p % rayleigh.shape[0]], ratios[p % ratios.shape[0]]
        valid, system, feed = dense_system(parameters, own, wanted, step)
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
