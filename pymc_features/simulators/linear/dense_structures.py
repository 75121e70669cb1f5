"""Dense structures in lanes: their modes and, with classical damping, misfits, responses and gradients.

One structure is a population of one, whose modes lie in the lanes of the march. What differs is who solves
the eigenproblem: LAPACK that of one structure, `eigen.structures` those of many, together.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.arrays import copy_entries
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.eigen.matrices import all_diagonal
from pymc_features.simulators.eigen.structures import StructureLanes, new_structures, solve_structures
from pymc_features.simulators.linear.dense import is_finite, solve_dense
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.numbers.vectors import load, splat, store
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION
from pymc_features.simulators.oscillators.evaluation import (
    Changes,
    Structures,
    damp,
    evaluate_structures,
    pull_back_structures,
    pull_back_sums,
    row_of,
    systems_of,
)
from pymc_features.simulators.oscillators.modal_lanes import clear, new_rows
from pymc_features.simulators.oscillators.samples import of_one, of_population
from pymc_features.simulators.oscillators.spread import terms_of

REPEATED = 1e-9  # of lambda: shapes of modes that are nearer are those that a structure by itself would get


@jit
def rows_of(parameters, p):
    """Row p of theta, rayleigh and ratios, or the only one."""
    return row_of(parameters.theta, p), row_of(parameters.rayleigh, p), row_of(parameters.ratios, p)


@jit
def n_structures(parameters):
    """Number of particles of a population."""
    return max(parameters.theta.shape[0], parameters.rayleigh.shape[0], parameters.ratios.shape[0])


class Solved(NamedTuple):
    """Modes of structures in lanes.

    Attributes
    ----------
    values, rows, load : array (n, lanes), (n n, lanes), (n d, lanes)
        omega^2, ascending, mode shapes in rows, and M influence - forces.
    are_forced : bool
        Whether there are forces.
    """

    values: np.ndarray
    rows: np.ndarray
    load: np.ndarray
    are_forced: bool


class Together(NamedTuple):
    """Room for structures that are solved together; `is_diagonal` tells whether M is."""

    solved: Solved
    lanes: StructureLanes
    is_diagonal: bool


@jit
def some_forces(parameters):
    """Whether there are forces."""
    return np.any(parameters.forces != 0.0)


@jit
def one_structure(parameters, wanted):
    """`Structures` with room for one."""
    (n, d), widths = parameters.influence.shape, of_one()
    like, motion = widths.structure, np.dot(wanted.sensors, parameters.influence)
    room = Solved(new_rows(n, like), new_rows(n * n, like), new_rows(n * d, like), some_forces(parameters))
    return Structures(parameters, wanted, parameters.influence, motion, room, widths)


@jit
def structures_together(parameters, wanted):
    """`Structures` with room for many."""
    (n, d), widths = parameters.influence.shape, of_population()
    lanes, motion = new_structures(n, parameters.theta.shape[1]), np.dot(wanted.sensors, parameters.influence)
    load = new_rows(n * d, widths.structure)
    solved = Solved(lanes.values, lanes.rows, load, some_forces(parameters))
    room = Together(solved, lanes, all_diagonal(parameters.mass, n))
    return Structures(parameters, wanted, parameters.influence, motion, room, widths)


@jit
def put_alone(solved, lot, lane, parameters, p):
    """Solve structure p by itself; its lane is empty if there is none."""
    n, n_all = parameters.influence.shape[0], lot.n_all
    valid, omega, rows, _, load = solve_dense(parameters, rows_of(parameters, p), 0.0, n_all, 0)
    for r in range(n_all if valid else 0):
        solved.values[r, lane] = omega[r] * omega[r]
        for i in range(n):
            solved.rows[r * n + i, lane] = rows[r, i]
    for i in range(load.size):
        solved.load[i, lane] = load[i // load.shape[1], i % load.shape[1]]
    lot.is_there[lane] = valid


@jit
def see_modes(structures, solved, lot):
    """Write what the march and the gradients take of the modes of all lanes."""
    wanted, forces, like = structures.wanted, structures.parameters.forces, structures.widths.structure
    (s, n), d, nil = wanted.sensors.shape, lot.n_inputs, 0.0 * like
    values, rows, load = view(solved.values, like), view(solved.rows, like), view(solved.load, like)
    squares, at, shapes = view(lot.squares, like), view(lot.at, like), view(lot.shapes, like)
    participation, forced = view(lot.participation, like), view(lot.forced, like)
    for r in range(lot.n_all):
        squares[r] = values[r]
        for i in range(d):
            total = nil
            for k in range(n):
                total = total + rows[r * n + k] * load[k * d + i]
            participation[r * d + i] = total
        for i in range(lot.at.shape[0] // lot.n_all):
            at[i * lot.n_all + r] = rows[r * n + i]
    for j in range(s):
        first, last = 0, n
        while first < last and wanted.sensors[j, first] == 0.0:
            first += 1
        while last > first and wanted.sensors[j, last - 1] == 0.0:
            last -= 1
        for r in range(lot.n_all):
            total = nil
            for i in range(first, last):
                total = total + rows[r * n + i] * wanted.sensors[j, i]
            shapes[j * lot.n_all + r] = total
        for i in range(d if solved.are_forced else 0):
            total = nil
            for r in range(lot.n_modes):
                share = nil
                for k in range(n):
                    share = share + rows[r * n + k] * forces[k, i]
                total = total + shapes[j * lot.n_all + r] * share
            forced[j * d + i] = total
    for lane in range(lot.is_there.size):
        if not lot.is_there[lane]:
            clear(lot, lane)


@jit
def solve_alone(structures, lot, place, highest):
    """Solve one structure by itself, see `evaluation`."""
    put_alone(structures.room, lot, 0, structures.parameters, place[0])
    see_modes(structures, structures.room, lot)
    damp(lot, structures.parameters, place[0], highest)


@jit
def solve_classical(structures, lot, place):
    """Write the modes of structures in lanes, solved together where that is possible."""
    (solved, lanes, is_diagonal), parameters, (first, count) = structures.room, structures.parameters, place
    for lane in range(lot.is_there.size):
        theta, rayleigh, ratios = rows_of(parameters, min(first + lane, count - 1))
        copy_entries(theta, lanes.theta[:, lane])
        is_given = is_finite(theta) and is_finite(rayleigh) and is_finite(ratios)
        lot.is_there[lane] = first + lane < count and is_given
    solve_structures(lanes, (parameters.mass, parameters.stiffness), is_diagonal)
    write_load(solved, lanes.mass, parameters, is_diagonal)
    for lane in range(lot.is_there.size):
        is_good, values = lanes.is_good[lane], solved.values
        for r in range(1, lot.n_modes if lot.at.shape[0] > 0 else 0):
            is_good &= values[r, lane] - values[r - 1, lane] > REPEATED * values[r, lane]
        if lot.is_there[lane] and not is_good:
            put_alone(solved, lot, lane, parameters, first + lane)
    see_modes(structures, solved, lot)


@jit
def solve_together(structures, lot, place, highest):
    """Solve structures with classical damping, see `evaluation`."""
    solve_classical(structures, lot, place)
    damp(lot, structures.parameters, place[0], highest)


@jit
def write_load(solved, mass, parameters, is_diagonal):
    """Write M influence - forces of all lanes, M by its lower half (n n, lanes)."""
    n, d = parameters.influence.shape
    for i in range(n):
        for j in range(d):
            total = splat(-parameters.forces[i, j])
            for k in range(i if is_diagonal else 0, i + 1 if is_diagonal else n):
                entry = load(mass, i * n + k if k <= i else k * n + i)
                total = total + entry * parameters.influence[k, j]
            store(solved.load, i * d + j, total)


@jit
def changes_of(parameters):
    """What theta changes of K and M."""
    n, n_theta = parameters.influence.shape[0], parameters.theta.shape[1]
    return Changes(n_theta, terms_of(parameters.stiffness, n), terms_of(parameters.mass, n), False)


@jit
def dense_statistics(parameters, excitation, wanted, observed, n_statistics):
    """Statistics (p, s, 1 or 4) of the misfits of a population; NaN for no structure.

    theta, rayleigh and ratios (p or 1, ...) have a row for each particle or one for all.
    """
    result = np.empty((n_structures(parameters), wanted.sensors.shape[0], n_statistics))
    structures = structures_together(parameters, wanted)
    evaluate_structures(solve_together, structures, excitation, observed, result, np.empty((0, 0)))
    return result


@jit
def evaluate_structure(parameters, excitation, wanted, observed, history):
    """Statistics (s, 4) of the misfit of a population of one; or its response, unless there is no history."""
    data = observed if history.shape[0] == 0 else np.empty((0, 0))
    result = np.empty((1, wanted.sensors.shape[0], 4 if history.shape[0] == 0 else 1))
    structures = one_structure(parameters, wanted)
    evaluate_structures(solve_alone, structures, excitation, data, result, history)
    return result[0]


@jit
def add_dense_gradients(parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradients of a population by e_j alone, weights (p, s, 1)."""
    structures, data = structures_together(parameters, wanted), (observed, weights, False)
    pull_back_structures(solve_together, structures, changes_of(parameters), excitation, data, gradients)


@jit
def add_dense_gradient(parameters, excitation, wanted, history, weights, is_given, gradients):
    """Add the gradient of a population of one, by data or, if `is_given`, by derivatives by the response."""
    structures, data = one_structure(parameters, wanted), (history, weights, is_given)
    pull_back_structures(solve_alone, structures, changes_of(parameters), excitation, data, gradients)


@jit
def spread_population(parameters, excitation, wanted, sums, gradients):
    """Add the gradients of structures under one input from sums over time, without close modes."""
    structures = structures_together(parameters, wanted)
    pull_back_sums(solve_together, structures, changes_of(parameters), excitation, sums, gradients)


@jit
def dense_systems(parameters, excitation, wanted, count):
    """`Systems` of dense structures with classical damping, of any inputs."""
    return systems_of(solve_together, structures_together(parameters, wanted), excitation, count)


@jit
def is_share_known(parameters, wanted):
    """Whether what stands before the inputs in the response is the same for all parameters."""
    is_acceleration = wanted.quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION)
    is_moved = wanted.n_modes == parameters.influence.shape[0] and not np.any(parameters.forces != 0.0)
    return is_moved or not is_acceleration
