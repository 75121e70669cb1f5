"""Dense structures with classical damping in lanes: misfits, responses and gradients, of many and of one.

Gradients of dense structures with classical damping, as `linear.gradient` takes them.
"""

import numpy as np

from pymc_features.simulators.compiled.arrays import copy_entries, positions
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.eigen.coupled import all_columns
from pymc_features.simulators.eigen.matrices import all_diagonal
from pymc_features.simulators.eigen.structures import new_structures, solve_structures
from pymc_features.simulators.linear.dense import is_finite, solve_dense
from pymc_features.simulators.long_records.systems import new_systems, put_modes
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION
from pymc_features.simulators.oscillators.march import evaluate, new_walk
from pymc_features.simulators.oscillators.modal_lanes import (
    NO_DAMPING,
    clear,
    new_modal_lanes,
    put_damping,
    system_of,
)
from pymc_features.simulators.oscillators.modal_system import has_fast, highest_step
from pymc_features.simulators.oscillators.reduction import bring, derive, derive_from, new_reduced
from pymc_features.simulators.oscillators.samples import of_one, of_population
from pymc_features.simulators.oscillators.spread import add_damping, new_spread, spread_to_theta, terms_of
from pymc_features.simulators.oscillators.sums import new_gradient_walk

REPEATED = 1e-9  # of lambda: shapes of modes that are nearer are those that a structure by itself would get


@jit
def new_lanes(parameters, excitation, wanted, with_gradients, samples, widths):
    """Lanes for structures; gradients take all their modes."""
    (s, n), m, step = wanted.sensors.shape, wanted.n_modes, excitation.dt / excitation.substeps
    sizes, motion = (n, n if with_gradients else m, m, s), np.dot(wanted.sensors, parameters.influence)
    return new_modal_lanes(sizes, motion, (with_gradients, False), samples, (step, wanted.quantity), widths)


@jit
def rows_of(arrays, p):
    """Row p of theta, rayleigh and ratios, or the only one."""
    theta, rayleigh, ratios = arrays
    return theta[p % theta.shape[0]], rayleigh[p % rayleigh.shape[0]], ratios[p % ratios.shape[0]]


@jit
def put_structure(lot, lane, parameters, own, wanted, highest):
    """Solve a structure by itself and write it into a lane; `own` are theta, rayleigh and ratios."""
    n_all, d, (_, rayleigh, ratios) = lot.n_all, lot.n_inputs, own
    valid, omega, rows, _, load = solve_dense(parameters, own, 0.0, n_all, lot.n_modes)
    if not valid:
        clear(lot, lane)
        return
    shapes, participation = np.dot(wanted.sensors, rows.T), np.dot(rows, load)
    forces = np.dot(rows[: lot.n_modes], parameters.forces)
    for r in range(n_all):
        lot.squares[r, lane] = omega[r] * omega[r]
        for i in range(d):
            lot.participation[r * d + i, lane] = participation[r, i]
        for j in range(lot.n_sensors):
            lot.shapes[j * n_all + r, lane] = shapes[j, r]
        for i in range(lot.at.shape[0] // n_all):
            lot.at[i * n_all + r, lane] = rows[r, i]
    for j in range(lot.n_sensors):
        for i in range(d):
            total = 0.0
            for r in range(lot.n_modes):
                total += shapes[j, r] * forces[r, i]
            lot.forced[j * d + i, lane] = total
    put_damping(lot, lane, rayleigh, ratios, NO_DAMPING, highest)


@jit
def wanted_columns(parameters, wanted):
    """Vectors whose products with the mode shapes misfits need: S', forces, and -forces, with the load.

    Columns (n, s + 2) and the influence (n,), as `solve_structures` takes them.
    """
    sensors, forces = wanted.sensors, parameters.forces[:, 0]
    n_sensors, n = sensors.shape
    forced = 1 if np.any(forces != 0.0) else 0
    columns = np.empty((n, n_sensors + 1 + forced))
    for i in range(n):
        for j in range(n_sensors):
            columns[i, j] = sensors[j, i]
        columns[i, n_sensors] = forces[i]
        columns[i, n_sensors + forced] = -forces[i]
    return columns, parameters.influence[:, 0].copy()


@jit
def put_products(lot, lane, products, order, wanted, with_shapes):
    """Write the modes of a lane from their products with `wanted_columns` or, with shapes, `all_columns`."""
    (vectors, values), n_all, (s, n) = products, lot.n_all, wanted.sensors.shape
    positions(values, lane, order)
    width = vectors.shape[0] // n
    forced = n if with_shapes else s if width > s + 1 else -1
    for r in range(n_all):
        row = order[r] * width
        lot.squares[r, lane], lot.participation[r, lane] = (
            values[order[r], lane],
            vectors[row + width - 1, lane],
        )
        if with_shapes:
            for i in range(n):
                lot.at[i * n_all + r, lane] = vectors[row + i, lane]
        for j in range(s):
            seen = 0.0
            if with_shapes:
                for i in range(n):
                    if wanted.sensors[j, i] != 0.0:
                        seen += wanted.sensors[j, i] * vectors[row + i, lane]
            else:
                seen = vectors[row + j, lane]
            lot.shapes[j * n_all + r, lane] = seen
    for j in range(s):
        total = 0.0
        for r in range(lot.n_modes if forced >= 0 else 0):
            total += lot.shapes[j * n_all + r, lane] * vectors[order[r] * width + forced, lane]
        lot.forced[j, lane] = total


@jit
def has_repeated(lot, lane):
    """Whether two modes of a lane have the same frequency to rounding."""
    found = False
    for r in range(1, lot.n_modes):
        found |= lot.squares[r, lane] - lot.squares[r - 1, lane] <= REPEATED * lot.squares[r, lane]
    return found


@jit
def solve_lanes(lot, structures, parameters, wanted, columns, place, highest):
    """Solve structures `first` ... of `count`, together where that is possible, and fill the lanes.

    `place` has the two numbers and whether M is diagonal.
    """
    (first, count, is_diagonal), n = place, wanted.sensors.shape[1]
    lots, with_shapes, order = lot.is_there.size, lot.at.shape[0] > 0, np.empty(n, dtype=np.int64)
    for lane in range(lots):
        own = rows_of(parameters[:3], min(first + lane, count - 1))
        copy_entries(own[0], structures.theta[:, lane])
    solve_structures(structures, (parameters.mass, parameters.stiffness), is_diagonal, columns)
    for lane in range(lots):
        own = rows_of(parameters[:3], min(first + lane, count - 1))
        is_there = first + lane < count and is_finite(own[0]) and is_finite(own[1]) and is_finite(own[2])
        if not is_there:
            clear(lot, lane)
        elif structures.is_good[lane]:
            products = structures.vectors, structures.values
            put_products(lot, lane, products, order, wanted, with_shapes)
            put_damping(lot, lane, own[1], own[2], NO_DAMPING, highest)
        if is_there and (not structures.is_good[lane] or (with_shapes and has_repeated(lot, lane))):
            put_structure(lot, lane, parameters, own, wanted, highest)


@jit
def dense_statistics(parameters, excitation, wanted, observed, n_statistics):
    """Statistics (p, s, 1 or 4) of the misfits of a population under one input; NaN for no structure.

    Parameters
    ----------
    parameters : LinearParameters
        theta, rayleigh and ratios (p or 1, ...) have a row for each particle or one for all.
    excitation : Excitation
        With one input (1, t).
    wanted : Outputs
    observed : array (s, u)
        Data.
    n_statistics : int
        One for e_j, or four.
    """
    (s, n_times), n, widths = observed.shape, wanted.sensors.shape[1], of_population()
    count = max(parameters.theta.shape[0], parameters.rayleigh.shape[0], parameters.ratios.shape[0])
    walk = new_walk(excitation, observed, n_times, wanted.n_modes, s, widths)
    lot = new_lanes(parameters, excitation, wanted, False, walk.samples, widths)
    result, columns = np.empty((count, s, n_statistics)), wanted_columns(parameters, wanted)
    structures = new_structures(n, parameters.theta.shape[1], columns[0].shape[1])
    highest, history, is_diagonal = (
        highest_step(excitation),
        np.empty((0, 0)),
        all_diagonal(parameters.mass, n),
    )
    for first in range(0, count, lot.is_there.size):
        solve_lanes(lot, structures, parameters, wanted, columns, (first, count, is_diagonal), highest)
        evaluate(lot, walk, history, first, result, widths)
    return result


@jit
def evaluate_structure(parameters, own, excitation, wanted, observed, history):
    """Statistics (s, 4) of the misfit of one structure; or its response in the history, unless it is empty.

    `own` are theta, rayleigh and ratios. NaN where they describe no structure.
    """
    s, m, n_times, widths = wanted.sensors.shape[0], wanted.n_modes, observed.shape[1], of_one()
    data = observed if history.shape[0] == 0 else np.empty((0, 0))
    walk = new_walk(excitation, data, n_times, m, s, widths)
    lot = new_lanes(parameters, excitation, wanted, False, walk.samples, widths)
    result = np.full((1, s, 4 if history.shape[0] == 0 else 1), np.nan)
    put_structure(lot, 0, parameters, own, wanted, highest_step(excitation))
    if lot.is_there[0]:
        evaluate(lot, walk, history, 0, result, widths)
    else:
        history[:] = np.nan
    return result[0]


@jit
def add_lane(lot, reduced, spread, lane, gradients):
    """Add the derivatives of one lane to gradients by theta, rayleigh and ratios; NaN for no structure."""
    if not lot.is_there[lane]:
        for gradient in gradients:
            gradient[:] = np.nan
        return
    for k in range(gradients[0].size):
        gradients[0][k] += spread.by_theta[k, lane]
    add_damping(lot, reduced, lane, gradients[1], gradients[2])


@jit
def add_dense_gradients(parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradients of a population by e_j alone, weights (p, s, 1), under one input (1, t)."""
    count, n, m, widths = weights.shape[0], wanted.sensors.shape[1], wanted.n_modes, of_population()
    walk = new_gradient_walk(excitation, observed, False, False, m, widths.wide, widths)
    lot = new_lanes(parameters, excitation, wanted, True, walk.samples, widths)
    n_theta, lots = parameters.theta.shape[1], lot.is_there.size
    reduced, spread, columns = (
        new_reduced(lot, widths),
        new_spread(lot, n_theta, False, widths),
        all_columns(parameters),
    )
    structures = new_structures(n, n_theta, n + 2)
    stiffness, mass = terms_of(parameters.stiffness, n), terms_of(parameters.mass, n)
    is_diagonal, highest = all_diagonal(parameters.mass, n), highest_step(excitation)
    for first in range(0, count, lots):
        solve_lanes(lot, structures, parameters, wanted, columns, (first, count, is_diagonal), highest)
        bring(lot, walk, weights, first)
        derive(lot, walk, reduced, widths)
        spread_to_theta(lot, reduced, stiffness, mass, parameters.influence, spread, widths)
        for lane in range(min(lots, count - first)):
            add_lane(lot, reduced, spread, lane, rows_of(gradients, first + lane))


@jit
def add_dense_gradient(parameters, own, excitation, wanted, history, weights, is_given, gradients):
    """Add the gradient of one structure to `gradients`; NaN where its parameters describe none.

    Parameters
    ----------
    parameters : LinearParameters
        For the matrices, dense.
    own, gradients : tuple of arrays (p,), (2,), (k,)
        theta, rayleigh and ratios.
    excitation : Excitation
    wanted : Outputs
    history : array (s, u)
        Data or, if `is_given`, derivatives by the response.
    weights : array (s, 1)
        Of e_j.
    """
    n, m, widths = wanted.sensors.shape[1], wanted.n_modes, of_one()
    walk = new_gradient_walk(excitation, history, is_given, False, m, widths.wide, widths)
    lot = new_lanes(parameters, excitation, wanted, True, walk.samples, widths)
    reduced, spread = new_reduced(lot, widths), new_spread(lot, own[0].size, False, widths)
    put_structure(lot, 0, parameters, own, wanted, highest_step(excitation))
    if lot.is_there[0]:
        bring(lot, walk, weights.reshape((1, *weights.shape)), 0)
        derive(lot, walk, reduced, widths)
        stiffness, mass = terms_of(parameters.stiffness, n), terms_of(parameters.mass, n)
        spread_to_theta(lot, reduced, stiffness, mass, parameters.influence, spread, widths)
    add_lane(lot, reduced, spread, 0, gradients)


@jit
def dense_systems(parameters, excitation, wanted, count):
    """`Systems` of dense structures with classical damping, of any inputs."""
    (s, n), n_inputs, widths = wanted.sensors.shape, parameters.influence.shape[1], of_population()
    systems, step = (
        new_systems(count, s, wanted.n_modes, n_inputs),
        excitation.dt / excitation.substeps,
    )
    walk = new_walk(excitation, np.empty((0, 0)), 1, wanted.n_modes, s, widths)
    lot = new_lanes(parameters, excitation, wanted, False, walk.samples, widths)
    columns, highest = wanted_columns(parameters, wanted), highest_step(excitation)
    structures = new_structures(n, parameters.theta.shape[1], columns[0].shape[1])
    is_diagonal = all_diagonal(parameters.mass, n)
    for first in range(0, count, lot.is_there.size):
        if n_inputs == 1:
            solve_lanes(lot, structures, parameters, wanted, columns, (first, count, is_diagonal), highest)
        for lane in range(min(lot.is_there.size, count - first)):
            if n_inputs > 1:
                put_structure(lot, lane, parameters, rows_of(parameters[:3], first + lane), wanted, highest)
            if lot.is_there[lane]:
                system, feed = system_of(lot, lane)
                if not has_fast(system, step, highest):
                    put_modes(systems, first + lane, system, feed)
    return systems


@jit
def is_share_known(parameters, wanted):
    """Whether what stands before the inputs in the response is the same for all parameters."""
    is_acceleration = wanted.quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION)
    is_moved = wanted.n_modes == parameters.influence.shape[0] and not np.any(parameters.forces != 0.0)
    return is_moved or not is_acceleration


@jit
def spread_population(parameters, excitation, wanted, sums, gradients):
    """Add the gradients of structures under one input from sums over time, without close modes."""
    count, n, m, widths = sums[0].shape[0], wanted.sensors.shape[1], wanted.n_modes, of_population()
    walk = new_walk(excitation, np.empty((0, 0)), 1, m, wanted.sensors.shape[0], widths)
    lot = new_lanes(parameters, excitation, wanted, True, walk.samples, widths)
    n_theta, lots = parameters.theta.shape[1], lot.is_there.size
    reduced, spread, columns = (
        new_reduced(lot, widths),
        new_spread(lot, n_theta, False, widths),
        all_columns(parameters),
    )
    structures = new_structures(n, n_theta, n + 2)
    stiffness, mass = terms_of(parameters.stiffness, n), terms_of(parameters.mass, n)
    is_diagonal, highest = all_diagonal(parameters.mass, n), highest_step(excitation)
    for first in range(0, count, lots):
        solve_lanes(lot, structures, parameters, wanted, columns, (first, count, is_diagonal), highest)
        derive_from(lot, sums, reduced, first, widths)
        spread_to_theta(lot, reduced, stiffness, mass, parameters.influence, spread, widths)
        for lane in range(min(lots, count - first)):
            add_lane(lot, reduced, spread, lane, rows_of(gradients, first + lane))
