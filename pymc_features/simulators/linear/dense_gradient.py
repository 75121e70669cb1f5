"""Gradients of dense structures with classical damping in compiled code: of one, or of a population.

The same chain rule as in `projection`, by all n modes of the structure at hand.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, store
from pymc_features.simulators.derivatives.history import sum_history
from pymc_features.simulators.derivatives.memory import clear, new_gradient_lanes, put, room_of_lanes
from pymc_features.simulators.derivatives.pairs import (
    derive_modes,
    derive_pairs,
    modes_apart,
    take_gradient,
    take_sums,
)
from pymc_features.simulators.linear.dense_population import solve_dense
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION, single_input
from pymc_features.simulators.oscillators.gradient import modal_gradient
from pymc_features.simulators.oscillators.modal_system import DampingLaw, ModalSystem
from pymc_features.simulators.oscillators.outside import outside_span


@jit
def add_gradient(parameters, own, excitation, wanted, history, weights, gradients):
    """Add the gradient of one structure to `gradients`; NaN where its parameters describe none.

    Parameters
    ----------
    parameters : LinearParameters
        For the matrices, dense.
    own, gradients : tuple of arrays (p,), (2,), (k,)
        theta, rayleigh and ratios.
    excitation : Excitation
    wanted : Outputs
    history, weights
        As in `oscillators.gradient.sum_histories`.
    """
    influence, sensors, m = parameters.influence, wanted.sensors, wanted.n_modes
    n, (_, rayleigh, ratios) = influence.shape[0], own
    step = excitation.dt / excitation.substeps
    valid, omega, rows, damping, load = solve_dense(parameters, own, step, n, m)
    if not valid:
        for gradient in gradients:
            gradient[:] = np.nan
        return
    kept, shapes = omega[:m].copy(), np.ascontiguousarray(rows[:m].T)
    system = ModalSystem(kept, damping, np.dot(sensors, shapes), np.dot(rows[:m], load))
    feed = np.dot(sensors, influence)
    if wanted.quantity != ABSOLUTE_ACCELERATION:
        feed[:] = 0.0
    law = DampingLaw(rayleigh, ratios[:m].copy())
    found = modal_gradient(system, law, feed, excitation, wanted.quantity, history, weights)
    spread_gradient(parameters, sensors, (omega, rows, load), found, gradients)


@jit
def spread_gradient(parameters, sensors, modes, found, gradients):
    """Add a `ModalGradient`, carried on to the parameters, to `gradients`; `modes` are of `solve_dense`."""
    (omega, rows, load), influence, n = modes, parameters.influence, parameters.influence.shape[0]
    (grad_theta, grad_rayleigh, grad_ratios), m = gradients, found.damping.size
    kept, shapes = omega[:m], np.ascontiguousarray(rows[:m].T)
    by_stiffness, by_mass = parameters.stiffness.shape[0] > 1, parameters.mass.shape[0] > 1
    left_stiffness, left_mass = np.dot(shapes, found.stiffness), np.dot(shapes, found.mass)
    if m < n and (by_stiffness or by_mass):
        outside = np.dot(sensors.T, found.shapes) + np.dot(load, found.load.T)
        outside = outside_span(omega, rows, m, outside)
        left_stiffness -= outside
        left_mass += outside * kept**2
    if by_stiffness:
        entries = np.dot(left_stiffness, rows[:m]).reshape(n * n)
        grad_theta += np.dot(parameters.stiffness[1:], entries)
    if by_mass:
        entries = np.dot(left_mass, rows[:m]) + np.dot(np.dot(shapes, found.load), influence.T)
        grad_theta += np.dot(parameters.mass[1:], entries.reshape(n * n))
    for r in range(m):
        grad_rayleigh[0] += found.damping[r]
        grad_rayleigh[1] += found.damping[r] * kept[r] ** 2
        grad_ratios[r] += found.damping[r] * 2.0 * kept[r]


@jit
def fill_lane(lanes, lane, own, sensors, modes, damping):
    """Write the modes of one structure under one input into a lane."""
    (omega, rows, load), (_, rayleigh, ratios), m = modes, own, damping.size
    participation, shapes = np.dot(rows[:m], load), np.dot(sensors, rows[:m].T)
    for r in range(m):
        slope = rayleigh[1]
        if omega[r] > 0.0:  # nothing changes the lambda of a rigid body
            slope += ratios[r] / omega[r]
        put(lanes.omega, r, lane, omega[r])
        put(lanes.damping, r, lane, damping[r])
        put(lanes.slopes, r, lane, slope)
        put(lanes.ratios, r, lane, ratios[r])
        put(lanes.participation, r, lane, participation[r, 0])
        for j in range(lanes.n_sensors):
            put(lanes.shapes, j * lanes.m + r, lane, shapes[j, r])


@jit
def own_arrays(parameters, gradients, p):
    """theta, rayleigh and ratios of particle p, and their gradients."""
    theta, rayleigh, ratios = parameters.theta, parameters.rayleigh, parameters.ratios
    i, j, k = p % theta.shape[0], p % rayleigh.shape[0], p % ratios.shape[0]
    grad_theta, grad_rayleigh, grad_ratios = gradients
    return (theta[i], rayleigh[j], ratios[k]), (grad_theta[i], grad_rayleigh[j], grad_ratios[k])


@jit
def add_groups(room, parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradients by e_j alone under one input, of a vector of structures at a time.

    A structure with modes that are close goes by itself, `add_gradient`. `room` is from `room_of_lanes`.
    """
    (sensors, m, quantity), n, n_times = wanted, parameters.influence.shape[0], observed.shape[1]
    step, motion = excitation.dt / excitation.substeps, single_input(excitation)
    feed = np.dot(sensors, parameters.influence)[:, 0].copy()
    if quantity != ABSOLUTE_ACCELERATION:
        feed[:] = 0.0
    lanes = new_gradient_lanes(room, feed, m, excitation.stride)
    valid, omega, rows = np.empty(LANES, dtype=np.bool_), np.empty((LANES, n)), np.empty((LANES, n, n))
    load, apart = np.empty((LANES, n, 1)), np.empty((1, LANES))
    for first in range(0, weights.shape[0], LANES):
        count = min(LANES, weights.shape[0] - first)
        for lane in range(LANES):
            clear(lanes, lane)
            if lane < count:
                own, _ = own_arrays(parameters, gradients, first + lane)
                found = solve_dense(parameters, own, step, n, m)
                valid[lane], omega[lane], rows[lane], damping, load[lane] = found
                if valid[lane]:
                    fill_lane(lanes, lane, own, sensors, (omega[lane], rows[lane], load[lane]), damping)
                for j in range(feed.size):
                    put(lanes.factors, j, lane, 2.0 * weights[first + lane, j, 0] / n_times)
        store(apart, 0, modes_apart(lanes, n_times * excitation.stride * step))
        sum_history(lanes, room, motion, quantity, observed)
        derive_modes(lanes, step, motion.acceleration[0])
        derive_pairs(lanes)
        for lane in range(count):
            own, own_gradients = own_arrays(parameters, gradients, first + lane)
            if valid[lane] and apart[0, lane] == 1.0:
                modes = omega[lane], rows[lane], load[lane]
                spread_gradient(parameters, sensors, modes, take_gradient(lanes, lane), own_gradients)
            else:
                w = weights[first + lane]
                add_gradient(parameters, own, excitation, wanted, observed, w, own_gradients)


@jit
def add_population_gradient(parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradients of all particles; what they share, in one row, gets the sum.

    theta, rayleigh and ratios, and `gradients` of their shapes, have one more axis in front; `weights` are
    (p, s, 1) or (p, s, 4).
    """
    if weights.shape[2] == 1 and weights.shape[0] > 2 and excitation.acceleration.shape[0] == 1:
        room = room_of_lanes(wanted.sensors.shape[0], wanted.n_modes, excitation.stride)
        add_groups(room, parameters, excitation, wanted, observed, weights, gradients)
        return
    for p in range(weights.shape[0]):
        own, own_gradients = own_arrays(parameters, gradients, p)
        add_gradient(parameters, own, excitation, wanted, observed, weights[p], own_gradients)


@jit
def spread_groups(room, parameters, excitation, wanted, sums, gradients):
    """Add the gradients of a vector of structures at a time, from sums over time, see `take_sums`.

    No two modes of a structure may be close; `room` and `gradients` as in `add_groups`.
    """
    (n_particles, n_sensors, m), n = sums[0].shape, parameters.influence.shape[0]
    step, lanes = excitation.dt / excitation.substeps, new_gradient_lanes(room, np.zeros(n_sensors), m, 1)
    valid, omega, rows = np.empty(LANES, dtype=np.bool_), np.empty((LANES, n)), np.empty((LANES, n, n))
    load = np.empty((LANES, n, 1))
    for first in range(0, n_particles, LANES):
        count = min(LANES, n_particles - first)
        for lane in range(LANES):
            clear(lanes, lane)
            if lane < count:
                own, _ = own_arrays(parameters, gradients, first + lane)
                found = solve_dense(parameters, own, step, n, m)
                valid[lane], omega[lane], rows[lane], damping, load[lane] = found
                if valid[lane]:
                    modes = omega[lane], rows[lane], load[lane]
                    fill_lane(lanes, lane, own, wanted.sensors, modes, damping)
        take_sums(lanes, sums, first, count)
        derive_pairs(lanes)
        for lane in range(count):
            _, own_gradients = own_arrays(parameters, gradients, first + lane)
            if valid[lane]:
                modes, derived = (omega[lane], rows[lane], load[lane]), take_gradient(lanes, lane)
                spread_gradient(parameters, wanted.sensors, modes, derived, own_gradients)
            else:
                for gradient in own_gradients:
                    gradient[:] = np.nan


@jit
def spread_population(parameters, excitation, wanted, sums, gradients):
    """As `spread_groups`, in memory of its own."""
    room = room_of_lanes(wanted.sensors.shape[0], wanted.n_modes, 1)
    spread_groups(room, parameters, excitation, wanted, sums, gradients)
