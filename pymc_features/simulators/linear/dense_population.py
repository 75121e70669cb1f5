"""Dense structures with classical damping in compiled code: one of them, or a population under one input."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.filling import empty_modes, fill_lanes, take_lane
from pymc_features.simulators.eigen.matrices import all_diagonal
from pymc_features.simulators.eigen.structures import new_structures, solve_structures
from pymc_features.simulators.linear.dense import assemble_dense, dense_modes, is_finite
from pymc_features.simulators.mean_squares.systems import new_systems, put_lane, put_modes
from pymc_features.simulators.oscillators.arguments import at_every_step
from pymc_features.simulators.oscillators.fast_modes import has_fast, highest_step
from pymc_features.simulators.oscillators.lanes import new_lanes
from pymc_features.simulators.oscillators.modal_system import (
    DampingLaw,
    ModalSystem,
    feed_through,
    write_feed,
)
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
def wanted_columns(parameters, wanted):
    """Vectors whose products with the mode shapes the outputs need: S', forces if there are any, -forces.

    Columns (n, s + 1) or (n, s + 2) and the influence (n,), as `solve_structures` takes them.
    """
    sensors, forces = wanted.sensors, parameters.forces[:, 0]
    forced, (n_sensors, n) = np.any(forces != 0.0), sensors.shape
    columns = np.empty((n, n_sensors + (2 if forced else 1)))
    for i in range(n):
        for j in range(n_sensors):
            columns[i, j] = sensors[j, i]
        columns[i, n_sensors] = forces[i]
        columns[i, columns.shape[1] - 1] = -forces[i]
    return columns, parameters.influence[:, 0].copy()


@jit
def write_outputs(lanes, lane, vectors, order, wanted, support_motion):
    """Write what the modes of one structure, in their order, do at the sensors, and the feed-through."""
    n, n_sensors, even_modes = order.size, support_motion.size, lanes.states.shape[0] // 2
    width, m = vectors.shape[0] // n, wanted.n_modes
    for j in range(n_sensors):
        by_modes, by_forces = 0.0, 0.0
        for r in range(m):
            row = order[r] * width
            share = vectors[row + j, lane] * vectors[row + width - 1, lane]
            lanes.shapes[j * even_modes + r, lane] = share
            by_modes += share
            if width > n_sensors + 1:
                by_forces += vectors[row + j, lane] * vectors[row + n_sensors, lane]
        motion = support_motion[j]
        feed = feed_through(motion, by_forces, by_modes, wanted.quantity, m == n)
        lanes.feed[j, lane], lanes.direct[j, lane] = feed, feed


@jit
def own_values(parameters, p):
    """theta, rayleigh and ratios of particle p."""
    theta, rayleigh, ratios = parameters.theta, parameters.rayleigh, parameters.ratios
    return theta[p % theta.shape[0]], rayleigh[p % rayleigh.shape[0]], ratios[p % ratios.shape[0]]


@jit
def bring(modes, parameters, first, count, is_there):
    """Write the theta of particles `first` ... into the lanes, and whether their parameters are finite."""
    for lane in range(LANES):
        theta, pair, ratios = own_values(parameters, min(first + lane, count - 1))
        is_there[lane] = first + lane < count and is_finite(theta) and is_finite(pair) and is_finite(ratios)
        modes.theta[:, lane] = theta


@jit
def march_dense(parameters, excitation, wanted, observed, increments):
    """Misfits of all particles, `LANES` at a time; those that have no place in a lane are solved alone.

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
    (n_sensors, n), motion, m = wanted.sensors.shape, at_every_step(excitation), wanted.n_modes
    count = max(theta.shape[0], rayleigh.shape[0], ratios.shape[0])
    result = np.full((count, n_sensors, 1 if increments is None else 4), np.nan)
    columns, stacks = wanted_columns(parameters, wanted), (parameters.mass, parameters.stiffness)
    lanes, modes = (
        new_lanes(observed, m, motion, False),
        new_structures(n, theta.shape[1], columns[0].shape[1]),
    )
    kept, order = (new_vectors(m), new_vectors(m)), np.empty(n, dtype=np.int64)
    is_diagonal, support_motion = all_diagonal(parameters.mass, n), np.dot(wanted.sensors, columns[1])
    is_there, alone = np.empty(LANES, dtype=np.bool_), np.empty(count, dtype=np.int64)
    n_alone, steps, start = 0, (motion.dt, highest_step(excitation)), motion.acceleration[0]
    for first in range(0, count, LANES):
        bring(modes, parameters, first, count, is_there)
        solve_structures(modes, stacks, is_diagonal, columns)
        for lane in range(LANES):
            if is_there[lane] and not modes.is_good[lane]:
                alone[n_alone] = first + lane
                n_alone += 1
            is_there[lane] &= modes.is_good[lane]
            if is_there[lane]:
                _, pair, own_ratios = own_values(parameters, first + lane)
                law = DampingLaw(pair, own_ratios)
                is_there[lane] = take_lane(kept, lane, modes.values, law, steps, order)
                if not is_there[lane]:  # no structure, or one with modes that follow
                    alone[n_alone] = first + lane
                    n_alone += 1
            if is_there[lane]:
                write_outputs(lanes, lane, modes.vectors, order, wanted, support_motion)
            else:
                empty_modes(kept, lane)
        fill_lanes(lanes, kept, motion.dt, wanted.quantity, start)
        found = lane_statistics(lanes, motion, observed, increments)
        for lane in range(LANES):
            if is_there[lane]:
                result[first + lane] = found[lane]
    march_alone(parameters, excitation, wanted, lanes, alone[:n_alone], (observed, increments, result))
    return result


@jit
def march_alone(parameters, excitation, wanted, lanes, places, data):
    """Write the misfits of some particles, whose modes are found one by one.

    Parameters
    ----------
    excitation : Excitation
        With one input (1, t).
    lanes : Lanes
        Empty.
    places : integer array
        Which particles.
    data : tuple
        Data (s, u), `Increments` or None, and the array that is written.
    """
    (observed, increments, result), waiting = data, 0
    at, motion, highest = np.empty(LANES, dtype=np.int64), at_every_step(excitation), highest_step(excitation)
    for i in range(places.size):
        own = own_values(parameters, places[i])
        valid, system, feed = dense_system(parameters, own, wanted, motion.dt)
        if valid and has_fast(system, motion.dt, highest):
            sums = np.zeros((1 if increments is None else 4, observed.shape[0]))
            march_modes(system, feed, excitation, wanted.quantity, observed, np.empty((0, 0)), sums)
            result[places[i]] = statistics(sums, observed.shape[1])
        elif valid:
            put_system(lanes, waiting, system, feed[:, 0].copy(), motion, wanted.quantity)
            at[waiting] = places[i]
            waiting += 1
        if waiting == LANES or (waiting > 0 and i == places.size - 1):
            found = lane_statistics(lanes, motion, observed, increments)
            for lane in range(waiting):
                result[at[lane]] = found[lane]
            waiting = 0


@jit
def dense_systems(parameters, excitation, wanted, count):
    """`Systems` of dense structures with classical damping, as `march_dense` has them; of any inputs."""
    (n_sensors, n), step = wanted.sensors.shape, excitation.dt / excitation.substeps
    highest = highest_step(excitation)
    n_inputs, m = parameters.influence.shape[1], wanted.n_modes
    systems = new_systems(count, n_sensors, m, n_inputs, False)
    is_there, is_alone = np.empty(LANES, dtype=np.bool_), np.ones(count, dtype=np.bool_)
    if n_inputs == 1:
        columns, stacks = wanted_columns(parameters, wanted), (parameters.mass, parameters.stiffness)
        modes = new_structures(n, parameters.theta.shape[1], columns[0].shape[1])
        kept, order = (new_vectors(m), new_vectors(m)), np.empty(n, dtype=np.int64)
        is_diagonal, motion = all_diagonal(parameters.mass, n), np.dot(wanted.sensors, columns[1])
        for first in range(0, count, LANES):
            bring(modes, parameters, first, count, is_there)
            solve_structures(modes, stacks, is_diagonal, columns)
            for lane in range(min(LANES, count - first)):
                is_alone[first + lane] = is_there[lane] and not modes.is_good[lane]
                _, pair, ratios = own_values(parameters, first + lane)
                law, is_kept = DampingLaw(pair, ratios), is_there[lane] and modes.is_good[lane]
                if is_kept and take_lane(kept, lane, modes.values, law, (step, highest), order):
                    shapes = modes.vectors, order, lane
                    put_lane(systems, first + lane, kept, shapes, (motion, wanted.quantity))
    for p in range(count):
        if is_alone[p]:
            valid, system, feed = dense_system(parameters, own_values(parameters, p), wanted, step)
            if valid and not has_fast(system, step, highest):
                put_modes(systems, p, system, feed)
    return systems
