"""Misfits of populations of dense structures whose damping is a matrix, by complex modes in vector lanes."""

import numpy as np

from pymc_features.algebra.factorisation import ZERO_STIFFNESS
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, load, magnitude, splat, store, where_less
from pymc_features.simulators.compiled.vector_math import larger
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.complex_modes import new_complex
from pymc_features.simulators.eigen.filling import positions
from pymc_features.simulators.eigen.matrices import (
    all_diagonal,
    assemble_lanes,
    factorise_lanes,
    multiply_lanes,
)
from pymc_features.simulators.eigen.pairs import fill_pairs
from pymc_features.simulators.eigen.structures import new_structures, solve_structures
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    at_every_step,
)
from pymc_features.simulators.oscillators.lanes import new_lanes
from pymc_features.simulators.oscillators.population import lane_statistics
from pymc_features.simulators.oscillators.recursion import STIFFEST


@jit
def march_coupled(parameters, excitation, wanted, observed, increments):
    """Misfits of the particles whose complex modes come out right, NaN of the others, and which those are.

    Parameters
    ----------
    parameters : LinearParameters
        theta (p or 1, k); dense matrices, C symmetric.
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
    bool array (p,)
        Whether they are written. The others may be invalid, lack mass, or have modes that coalesce.
    """
    theta, (n_sensors, n), m = parameters.theta, wanted.sensors.shape, wanted.n_modes
    count, motion = theta.shape[0], at_every_step(excitation)
    result = np.full((count, n_sensors, 1 if increments is None else 4), np.nan)
    is_written = np.zeros(count, dtype=np.bool_)
    columns, stacks = all_columns(parameters), (parameters.mass, parameters.stiffness)
    lanes, modes = new_lanes(observed, m, excitation.stride, True), new_complex(m, n_sensors)
    structures = new_structures(n, theta.shape[1], columns[0].shape[1])
    damping, products, room = (
        new_vectors(n * n),
        new_vectors(m * (n + 2)),
        new_vectors(m * n),
    )
    order, step, start = np.empty(n, dtype=np.int64), motion.dt, motion.acceleration[0]
    is_diagonal, support_motion = all_diagonal(parameters.mass, n), np.dot(wanted.sensors, columns[1])
    for first in range(0, count, LANES):
        for lane in range(LANES):
            structures.theta[:, lane] = theta[min(first + lane, count - 1)]
        solve_structures(structures, stacks, is_diagonal, columns)
        for lane in range(LANES):
            modes.is_good[0, lane] = 1.0 if structures.is_good[lane] and first + lane < count else 0.0
        sort_modes(structures, modes, (products, order))
        assemble_lanes(parameters.damping, structures.theta, n, True, damping)
        project(modes, damping, products, n, room)
        check_damping(modes, structures.factor, damping, step, n)
        write_sensors(modes, lanes, products, wanted, support_motion)
        fill_pairs(lanes, modes, n_sensors, step, wanted.quantity, start)
        found = lane_statistics(lanes, motion, observed, increments)
        for lane in range(LANES):
            if modes.is_good[0, lane] > 0.0:
                result[first + lane], is_written[first + lane] = found[lane], True
    return result, is_written


@jit
def all_columns(parameters):
    """The identity, forces and -forces, (n, n + 2), and the influence (n,), for `solve_structures`."""
    n, forces = parameters.influence.shape[0], parameters.forces[:, 0]
    columns = np.zeros((n, n + 2))
    for i in range(n):
        columns[i, i], columns[i, n], columns[i, n + 1] = 1.0, forces[i], -forces[i]
    return columns, parameters.influence[:, 0].copy()


@jit
def sort_modes(structures, modes, room):
    """Write omega of the lowest modes, and their products with the columns in the same order.

    `room` is a matrix (m w, LANES), the products, and the order (n,).
    """
    (products, order), m = room, modes.omega.shape[0]
    width = products.shape[0] // m
    for i in range(m * width):  # of the lanes that are in order, as nearly all are
        store(products, i, load(structures.vectors, i))
    for lane in range(LANES):
        if modes.is_good[0, lane] == 0.0:
            continue
        positions(structures.values, lane, order)
        for r in range(m):
            modes.omega[r, lane] = np.sqrt(structures.values[order[r], lane])
            if order[r] != r:
                for c in range(width):
                    products[r * width + c, lane] = structures.vectors[order[r] * width + c, lane]


@jit
def project(modes, damping, products, n, room):
    """Write D = Phi'C Phi and Gamma.

    `damping` are matrices C (n n, LANES), `products` those of `sort_modes`, `room` a matrix (m n, LANES).
    """
    m = modes.omega.shape[0]
    width = products.shape[0] // m
    for r in range(m):
        store(modes.participation, r, load(products, r * width + width - 1))
    multiply_lanes((products, width, 1), (damping, n, 1), (m, n, n), room)
    multiply_lanes((room, n, 1), (products, 1, width), (m, n, m), modes.damping)


@jit
def check_damping(modes, factor, damping, step, n):
    """Take the lanes out of the good ones where D has a negative eigenvalue, or is too stiff to be stepped.

    `factor` is that of M, (n n, LANES), and `damping` C, which is overwritten.
    """
    m, zero = modes.omega.shape[0], splat(0.0)
    inertia = drag = stiffest = zero
    for i in range(n):
        drag = drag + load(damping, i * n + i)
        for k in range(i + 1):
            entry = load(factor, i * n + k)
            inertia = inertia + entry * entry
    ratio = magnitude(drag) / inertia
    shift = ZERO_STIFFNESS * where_less(zero, ratio, ratio, splat(1.0))
    for r in range(m):
        stiffest = larger(stiffest, larger(load(modes.omega, r), load(modes.damping, r * m + r)))
        for s in range(r + 1):
            store(damping, r * m + s, load(modes.damping, r * m + s) + (shift if r == s else zero))
    factorise_lanes(damping, m, False)
    passed = where_less(zero, load(damping, m * m - 1), load(modes.is_good, 0), zero)
    store(modes.is_good, 0, where_less(stiffest * step, splat(STIFFEST), passed, zero))


@jit
def write_sensors(modes, lanes, products, wanted, support_motion):
    """Write the modes at the sensors, and the feed-through of the input."""
    n_sensors, n = wanted.sensors.shape
    m, width = modes.omega.shape[0], n + 2
    is_absolute = wanted.quantity == ABSOLUTE_ACCELERATION
    for j in range(n_sensors):
        by_modes = by_forces = splat(0.0)
        for s in range(m):
            seen = splat(0.0)
            for c in range(n):
                if wanted.sensors[j, c] != 0.0:
                    seen = seen + load(products, s * width + c) * wanted.sensors[j, c]
            store(modes.seen, j * m + s, seen)
            by_modes = by_modes + seen * load(products, s * width + n + 1)
            by_forces = by_forces + seen * load(products, s * width + n)
        motion = splat(support_motion[j])
        if m == n:  # their sum is then known without its rounding error
            by_modes = motion - by_forces
        feed = motion - by_modes if is_absolute else splat(0.0) - by_modes
        is_acceleration = is_absolute or wanted.quantity == RELATIVE_ACCELERATION
        store(lanes.feed, j, feed if is_acceleration else splat(0.0))
