"""Misfits of populations of dense structures whose damping is a matrix, by complex modes in vector lanes."""

import numpy as np

from pymc_features.algebra import ZERO_STIFFNESS
from pymc_features.simulators.compiled.arrays import positions
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, load, magnitude, splat, store, where_less
from pymc_features.simulators.compiled.vector_math import larger
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.complex_modes import (
    fill_lanes,
    new_complex,
    new_oscillator_pairs,
    write_pairs,
)
from pymc_features.simulators.eigen.matrices import (
    all_diagonal,
    assemble_lanes,
    factorise_lanes,
    filled_places,
    is_never_negative,
    multiply_lanes,
    multiply_sparse,
)
from pymc_features.simulators.eigen.structures import new_structures, solve_structures
from pymc_features.simulators.oscillators.march import evaluate, new_walk
from pymc_features.simulators.oscillators.modal_lanes import new_modal_lanes
from pymc_features.simulators.oscillators.modal_system import highest_coupled_step
from pymc_features.simulators.oscillators.samples import of_population

FEW = 0.3  # share of the entries of C below which those that are zero are passed over


@jit
def march_coupled(parameters, excitation, wanted, observed, n_statistics):
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
    n_statistics : int
        One for e_j, or four.

    Returns
    -------
    array (p, s, n_statistics)
    bool array (p,)
        Whether they are written. The others may be invalid, lack mass, or have modes that coalesce.
    """
    theta, (n_sensors, n), m = parameters.theta, wanted.sensors.shape, wanted.n_modes
    count, widths, step = theta.shape[0], of_population(), excitation.dt / excitation.substeps
    result, history = np.empty((count, n_sensors, n_statistics)), np.empty((0, 0))
    is_written = np.zeros(count, dtype=np.bool_)
    columns, stacks = all_columns(parameters), (parameters.mass, parameters.stiffness)
    pairs, modes = new_oscillator_pairs(m, n_sensors), new_complex(m, n_sensors)
    walk = new_walk(excitation, observed, observed.shape[1], 2 * m, n_sensors, widths)
    lot = new_lanes(parameters, wanted, m, walk.samples, step, widths)
    structures = new_structures(n, theta.shape[1], columns[0].shape[1])
    damping, room = new_vectors(n * n), new_vectors(m * n)
    places = filled_places(parameters.damping, n)
    is_safe = is_never_negative(parameters.damping, n)
    order, highest = np.empty(n, dtype=np.int64), highest_coupled_step(excitation) / step
    is_diagonal, support_motion = all_diagonal(parameters.mass, n), np.dot(wanted.sensors, columns[1])
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
        evaluate(lot, walk, history, first, result, widths)
        for lane in range(min(LANES, count - first)):
            is_written[first + lane] = lot.is_there[lane]
    return result, is_written


@jit
def new_lanes(parameters, wanted, m, samples, step, widths):
    """Lanes for structures of m pairs of modes under one input."""
    sizes, motion = (
        (2 * m, 2 * m, 2 * m, wanted.sensors.shape[0]),
        np.dot(wanted.sensors, parameters.influence),
    )
    return new_modal_lanes(sizes, motion, (False, True), samples, (step, wanted.quantity), widths)


@jit
def all_columns(parameters):
    """The identity, forces and -forces, (n, n + 2), and the influence (n,), for `solve_structures`."""
    n, forces = parameters.influence.shape[0], parameters.forces[:, 0]
    columns = np.zeros((n, n + 2))
    for i in range(n):
        columns[i, i], columns[i, n], columns[i, n + 1] = 1.0, forces[i], -forces[i]
    return columns, parameters.influence[:, 0].copy()


@jit
def sort_modes(structures, modes, order):
    """Write omega of the lowest modes, and return their products with the columns, (m w, LANES), in order.

    The products are those of `structures`, whose lanes are in order nearly always. `order` (n,) is
    overwritten.
    """
    n, m = order.size, modes.omega.shape[0]
    width = structures.vectors.shape[0] // n
    for lane in range(LANES):
        if modes.is_good[0, lane] == 0.0:
            continue
        positions(structures.values, lane, order)
        is_in_order = True
        for r in range(m):
            modes.omega[r, lane] = np.sqrt(structures.values[order[r], lane])
            is_in_order &= order[r] == r
        if not is_in_order:
            found = structures.vectors[:, lane].copy().reshape((n, width))
            structures.vectors[:, lane] = found[order].ravel()
    return structures.vectors[: m * width]


@jit
def project(modes, damping, places, products, room):
    """Write D = Phi'C Phi and Gamma.

    `damping` are matrices C (n n, LANES), zero but at `filled_places`, `products` those of `sort_modes`, and
    `room` a matrix (m n, LANES).
    """
    m, n = modes.omega.shape[0], places[0].size - 1
    width = products.shape[0] // m
    for r in range(m):
        store(modes.participation, r, load(products, r * width + width - 1))
    left, is_sparse = (products, width, 1), places[1].size < FEW * n * n
    if is_sparse:
        multiply_sparse(left, damping, places, (m, n), room)
    else:
        multiply_lanes(left, (damping, n, 1), (m, n, n), room, True)
    multiply_lanes((room, n, 1), (products, 1, width), (m, n, m), modes.damping, False)


@jit
def check_damping(modes, factor, damping, highest, is_safe):
    """Take the lanes out of the good ones where D has a negative eigenvalue, or a mode is too fast.

    `factor` is that of M, (n n, LANES), `damping` C, which is overwritten, `highest` the largest omega and D
    [1/s] that can be stepped, and `is_safe` tells whether no eigenvalue can be negative, see
    `is_never_negative`.
    """
    stiffest = splat(0.0)
    for r in range(modes.omega.shape[0]):
        own = load(modes.damping, r * modes.omega.shape[0] + r)
        stiffest = larger(stiffest, larger(load(modes.omega, r), own))
    if not is_safe:
        check_sign(modes, factor, damping)
    store(
        modes.is_good,
        0,
        where_less(stiffest, splat(highest), load(modes.is_good, 0), splat(0.0)),
    )


@jit
def check_sign(modes, factor, damping):
    """Take the lanes out of the good ones where D has a negative eigenvalue."""
    m, n, zero = modes.omega.shape[0], int(np.sqrt(damping.shape[0])), splat(0.0)
    inertia = drag = zero
    for i in range(n):
        drag = drag + load(damping, i * n + i)
        for k in range(i + 1):
            entry = load(factor, i * n + k)
            inertia = inertia + entry * entry
    ratio = magnitude(drag) / inertia
    shift = ZERO_STIFFNESS * where_less(zero, ratio, ratio, splat(1.0))
    for r in range(m):
        for s in range(r + 1):
            store(damping, r * m + s, load(modes.damping, r * m + s) + (shift if r == s else zero))
    factorise_lanes(damping, m, False)
    store(modes.is_good, 0, where_less(zero, load(damping, m * m - 1), load(modes.is_good, 0), zero))


@jit
def write_sensors(modes, forced, products, wanted, support_motion):
    """Write the modes at the sensors, and S iota less S Phi Gamma, (s, LANES)."""
    n_sensors, n = wanted.sensors.shape
    m, width = modes.omega.shape[0], n + 2
    for j in range(n_sensors):
        by_modes = by_forces = splat(0.0)
        first, last = 0, n
        while first < last and wanted.sensors[j, first] == 0.0:
            first += 1
        while last > first and wanted.sensors[j, last - 1] == 0.0:
            last -= 1
        for s in range(m):
            seen = splat(0.0)
            for c in range(first, last):
                seen = seen + load(products, s * width + c) * wanted.sensors[j, c]
            store(modes.seen, j * m + s, seen)
            by_modes = by_modes + seen * load(products, s * width + n + 1)
            by_forces = by_forces + seen * load(products, s * width + n)
        # with all modes their sum is known without its rounding error
        store(forced, j, by_forces if m == n else support_motion[j] - by_modes)
