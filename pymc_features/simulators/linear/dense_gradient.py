"""Gradients of dense structures with classical damping in compiled code: of one, or of a population.

The same chain rule as in `projection`, by all n modes of the structure at hand.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, store
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.derivatives.dense import add_damping, new_spread, spread_lanes
from pymc_features.simulators.derivatives.history import sum_history
from pymc_features.simulators.derivatives.memory import clear, new_gradient_lanes, put, room_of_lanes
from pymc_features.simulators.derivatives.pairs import derive_modes, derive_pairs, modes_apart, take_sums
from pymc_features.simulators.eigen.coupled import all_columns
from pymc_features.simulators.eigen.filling import take_lane
from pymc_features.simulators.eigen.matrices import all_diagonal
from pymc_features.simulators.eigen.outside import outside_span
from pymc_features.simulators.eigen.structures import StructureLanes, new_structures, solve_structures
from pymc_features.simulators.linear.dense_population import bring, solve_dense
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    seen_data,
    single_input,
)
from pymc_features.simulators.oscillators.fast_modes import highest_step
from pymc_features.simulators.oscillators.gradient import modal_gradient
from pymc_features.simulators.oscillators.modal_system import DampingLaw, ModalSystem


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
def fill_lane(lanes, lane, own, solved, wanted):
    """Write the modes of one structure under one input into a lane.

    `solved` has omega and D (m, LANES), the products of the modes with the columns of `all_columns`, and the
    order of the modes.
    """
    (kept, damping), products, order = solved
    (_, rayleigh, ratios), (n_sensors, n) = own, wanted.sensors.shape
    width = n + 2
    for r in range(lanes.n_modes):
        omega, row, slope = kept[r, lane], order[r] * width, rayleigh[1]
        if omega > 0.0:  # nothing changes the lambda of a rigid body
            slope += ratios[r] / omega
        put(lanes.omega, r, lane, omega)
        put(lanes.damping, r, lane, damping[r, lane])
        put(lanes.slopes, r, lane, slope)
        put(lanes.ratios, r, lane, ratios[r])
        put(lanes.participation, r, lane, products[row + width - 1, lane])
        for j in range(n_sensors):
            seen = 0.0
            for i in range(n):
                if wanted.sensors[j, i] != 0.0:
                    seen += wanted.sensors[j, i] * products[row + i, lane]
            put(lanes.shapes, j * lanes.m + r, lane, seen)


@jit
def write_ordered(rows, lane, structures, order):
    """Write omega^2 (n, LANES), and the modes' products with all columns, of one lane in ascending order."""
    (values, vectors), n = rows, order.size
    width = vectors.shape[0] // n
    for r in range(n):
        values[r, lane] = structures.values[order[r], lane]
        for c in range(width):
            vectors[r * width + c, lane] = structures.vectors[order[r] * width + c, lane]


@jit
def own_arrays(parameters, gradients, p):
    """theta, rayleigh and ratios of particle p, and their gradients."""
    theta, rayleigh, ratios = parameters.theta, parameters.rayleigh, parameters.ratios
    i, j, k = p % theta.shape[0], p % rayleigh.shape[0], p % ratios.shape[0]
    grad_theta, grad_rayleigh, grad_ratios = gradients
    return (theta[i], rayleigh[j], ratios[k]), (grad_theta[i], grad_rayleigh[j], grad_ratios[k])


class DenseGroup(NamedTuple):
    """Structures, one in each lane, on their way to a gradient, and what all of them share.

    `columns` are of `all_columns`; `kept` has omega and D of the modes kept (m, LANES), `rows` omega^2 and
    the modes' products with all columns in ascending order; `spread` is room for `spread_lanes`.
    """

    structures: StructureLanes
    is_diagonal: bool
    columns: tuple
    kept: tuple
    order: np.ndarray
    rows: tuple
    is_there: np.ndarray
    spread: tuple
    by_theta: np.ndarray


@jit
def new_group(parameters, m):
    """Room for `LANES` structures, of which m modes are kept."""
    n, n_theta = parameters.influence.shape[0], parameters.theta.shape[1]
    return DenseGroup(
        new_structures(n, n_theta, n + 2),
        all_diagonal(parameters.mass, n),
        all_columns(parameters),
        (new_vectors(m), new_vectors(m)),
        np.empty(n, dtype=np.int64),
        (new_vectors(n), new_vectors(n * (n + 2))),
        np.empty(LANES, dtype=np.bool_),
        new_spread(n, m),
        new_vectors(n_theta),
    )


@jit
def fill_lanes(lanes, group, parameters, gradients, wanted, place):
    """Solve the structures from the first on, and write those into the lanes that are there and have a place.

    `place` is the first structure, their number, and `steps` of `take_lane`.
    """
    first, count, steps = place
    structures, stacks = group.structures, (parameters.mass, parameters.stiffness)
    bring(structures, parameters, first, count, group.is_there)
    solve_structures(structures, stacks, group.is_diagonal, group.columns)
    for lane in range(LANES):
        clear(lanes, lane)
        group.is_there[lane] &= structures.is_good[lane]
        if group.is_there[lane]:
            own, _ = own_arrays(parameters, gradients, first + lane)
            law = DampingLaw(own[1], own[2])
            values = structures.values
            group.is_there[lane] = take_lane(group.kept, lane, values, law, steps, group.order)
        if group.is_there[lane]:
            solved = group.kept, structures.vectors, group.order
            fill_lane(lanes, lane, own, solved, wanted)
            write_ordered(group.rows, lane, structures, group.order)


@jit
def add_groups(room, parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradients by e_j alone under one input, of a vector of structures at a time.

    A structure with modes that are close, or that has no place in a lane, goes by itself, `add_gradient`.
    `room` is from `room_of_lanes`.
    """
    (sensors, m, quantity), n_times, count = wanted, observed.shape[1], weights.shape[0]
    step, motion = excitation.dt / excitation.substeps, single_input(excitation)
    feed, seen = np.dot(sensors, parameters.influence)[:, 0].copy(), observed
    if quantity == RELATIVE_ACCELERATION:
        seen = seen_data(motion, observed, feed)
    if quantity != ABSOLUTE_ACCELERATION:
        feed[:] = 0.0
    lanes, group = new_gradient_lanes(room, feed, m, excitation.stride), new_group(parameters, m)
    steps = step, highest_step(excitation)
    apart = new_vectors(1)
    for first in range(0, count, LANES):
        fill_lanes(lanes, group, parameters, gradients, wanted, (first, count, steps))
        for lane in range(LANES):
            if group.is_there[lane]:
                for j in range(feed.size):
                    put(lanes.factors, j, lane, 2.0 * weights[first + lane, j, 0] / n_times)
        store(apart, 0, modes_apart(lanes, n_times * excitation.stride * step))
        sum_history(lanes, room, motion, quantity, seen)
        derive_modes(lanes, step, motion.acceleration[0])
        derive_pairs(lanes)
        group.by_theta.fill(0.0)
        spread_lanes(parameters, sensors, lanes, group.rows, group.spread, group.by_theta)
        for lane in range(min(LANES, count - first)):
            own, own_gradients = own_arrays(parameters, gradients, first + lane)
            if group.is_there[lane] and apart[0, lane] == 1.0:
                own_gradients[0][:] += group.by_theta[:, lane]
                add_damping(lanes, lane, own_gradients)
            else:
                w = weights[first + lane]
                add_gradient(parameters, own, excitation, wanted, observed, w, own_gradients)


@jit
def spread_groups(room, parameters, excitation, wanted, sums, gradients):
    """Add the gradients of a vector of structures at a time, from sums over time, see `take_sums`.

    No two modes of a structure may be close; `room` and `gradients` as in `add_groups`.
    """
    (count, n_sensors, m), step = sums[0].shape, excitation.dt / excitation.substeps
    steps = step, highest_step(excitation)
    lanes, group = new_gradient_lanes(room, np.zeros(n_sensors), m, 1), new_group(parameters, m)
    for first in range(0, count, LANES):
        fill_lanes(lanes, group, parameters, gradients, wanted, (first, count, steps))
        take_sums(lanes, sums, first, min(LANES, count - first))
        derive_pairs(lanes)
        group.by_theta.fill(0.0)
        spread_lanes(parameters, wanted.sensors, lanes, group.rows, group.spread, group.by_theta)
        for lane in range(min(LANES, count - first)):
            _, own_gradients = own_arrays(parameters, gradients, first + lane)
            if group.is_there[lane]:
                own_gradients[0][:] += group.by_theta[:, lane]
                add_damping(lanes, lane, own_gradients)
            else:
                for gradient in own_gradients:
                    gradient[:] = np.nan


@jit
def spread_population(parameters, excitation, wanted, sums, gradients):
    """As `spread_groups`, in memory of its own."""
    room = room_of_lanes(wanted.sensors.shape[0], wanted.n_modes, 1)
    spread_groups(room, parameters, excitation, wanted, sums, gradients)


@jit
def is_share_known(parameters, wanted):
    """Whether what stands before the inputs in the response is the same for all parameters."""
    is_acceleration = wanted.quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION)
    is_moved = wanted.n_modes == parameters.influence.shape[0] and not np.any(parameters.forces != 0.0)
    return is_moved or not is_acceleration


@jit
def add_population_gradient(parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradients of all particles; what they share, in one row, gets the sum.

    theta, rayleigh and ratios, and `gradients` of their shapes, have one more axis in front; `weights` are
    (p, s, 1) or (p, s, 4).
    """
    goes_in_lanes = weights.shape[2] == 1 and weights.shape[0] > 2 and excitation.acceleration.shape[0] == 1
    if goes_in_lanes and (excitation.direct.size == 0 or is_share_known(parameters, wanted)):
        room = room_of_lanes(wanted.sensors.shape[0], wanted.n_modes, excitation.stride)
        add_groups(room, parameters, excitation, wanted, observed, weights, gradients)
        return
    for p in range(weights.shape[0]):
        own, own_gradients = own_arrays(parameters, gradients, p)
        add_gradient(parameters, own, excitation, wanted, observed, weights[p], own_gradients)
