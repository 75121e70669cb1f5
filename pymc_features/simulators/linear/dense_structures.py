"""Dense structures in lanes: their modes and, with classical damping, misfits, responses and gradients.

One structure is a population of one, whose modes lie in the lanes of the march. What differs is who solves
the eigenproblem: LAPACK that of one structure, `eigen.structures` those of many, together.
"""

from typing import NamedTuple

import numpy as np
from numba.extending import overload

from pymc_features.simulators.compiled.arrays import copy_entries
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.eigen.matrices import all_diagonal
from pymc_features.simulators.eigen.structures import StructureLanes, new_structures, solve_structures
from pymc_features.simulators.linear.dense import is_finite, solve_dense
from pymc_features.simulators.long_records.systems import new_systems, put_modes
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.numbers.vectors import load, splat, store
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION
from pymc_features.simulators.oscillators.march import evaluate, new_walk
from pymc_features.simulators.oscillators.modal_lanes import (
    NO_DAMPING,
    ModalLanes,
    clear,
    new_modal_lanes,
    new_rows,
    put_damping,
    system_of,
)
from pymc_features.simulators.oscillators.modal_system import has_fast, highest_step
from pymc_features.simulators.oscillators.reduction import Reduced, bring, derive, derive_from, new_reduced
from pymc_features.simulators.oscillators.samples import Widths, of_one, of_population
from pymc_features.simulators.oscillators.spread import (
    Spread,
    Terms,
    add_damping,
    new_spread,
    spread_to_theta,
    terms_of,
)
from pymc_features.simulators.oscillators.sums import new_gradient_walk

REPEATED = 1e-9  # of lambda: shapes of modes that are nearer are those that a structure by itself would get


@jit
def rows_of(arrays, p):
    """Row p of theta, rayleigh and ratios, or the only one."""
    theta, rayleigh, ratios = arrays
    return theta[p % theta.shape[0]], rayleigh[p % rayleigh.shape[0]], ratios[p % ratios.shape[0]]


@jit
def n_structures(parameters):
    """Number of particles of a population."""
    return max(parameters.theta.shape[0], parameters.rayleigh.shape[0], parameters.ratios.shape[0])


class DenseLanes(NamedTuple):
    """Dense structures in lanes.

    Attributes
    ----------
    lot : ModalLanes
    values, rows, load : array (n, lanes), (n n, lanes), (n d, lanes)
        omega^2, ascending, mode shapes in rows, and M influence - forces.
    are_forced : bool
        Whether there are forces.
    """

    lot: ModalLanes
    values: np.ndarray
    rows: np.ndarray
    load: np.ndarray
    are_forced: bool


@jit
def new_dense(parameters, excitation, wanted, with_gradients, room, samples, widths):
    """Lanes for structures, of which gradients take all modes; `room` is for their eigenproblems."""
    (s, n), d, m = wanted.sensors.shape, parameters.influence.shape[1], wanted.n_modes
    step, motion = excitation.dt / excitation.substeps, np.dot(wanted.sensors, parameters.influence)
    sizes, request = (n, n if with_gradients else m, m, s), (step, wanted.quantity)
    lot = new_modal_lanes(sizes, motion, (with_gradients, False), samples, request, widths)
    are_forced = False
    for i in range(n):
        for j in range(d):
            are_forced |= parameters.forces[i, j] != 0.0
    return DenseLanes(lot, room[0], room[1], new_rows(n * d, widths.structure), are_forced)


@jit
def put_alone(dense, lane, parameters, p):
    """Solve structure p by itself; its lane is empty if there is none."""
    n, n_all, own = parameters.influence.shape[0], dense.lot.n_all, rows_of(parameters[:3], p)
    valid, omega, rows, _, load = solve_dense(parameters, own, 0.0, n_all, 0)
    for r in range(n_all if valid else 0):
        dense.values[r, lane] = omega[r] * omega[r]
        for i in range(n):
            dense.rows[r * n + i, lane] = rows[r, i]
    for i in range(load.size):
        dense.load[i, lane] = load[i // load.shape[1], i % load.shape[1]]
    dense.lot.is_there[lane] = valid


@jit
def see_modes(dense, parameters, wanted, widths):
    """Write what the march and the gradients take of the modes of all lanes."""
    lot, like, (s, n), d = dense.lot, widths.structure, wanted.sensors.shape, dense.lot.n_inputs
    rows, load, shapes = view(dense.rows, like), view(dense.load, like), view(lot.shapes, like)
    values, squares, at = view(dense.values, like), view(lot.squares, like), view(lot.at, like)
    participation, forced, nil = view(lot.participation, like), view(lot.forced, like), 0.0 * like
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
        for i in range(d if dense.are_forced else 0):
            total = nil
            for r in range(lot.n_modes):
                share = nil
                for k in range(n):
                    share = share + rows[r * n + k] * parameters.forces[k, i]
                total = total + shapes[j * lot.n_all + r] * share
            forced[j * d + i] = total
    for lane in range(lot.is_there.size):
        if not lot.is_there[lane]:
            clear(lot, lane)


class Alone(NamedTuple):
    """Room for the eigenproblem of one structure: omega^2, shapes in rows; and the widths of its numbers."""

    values: np.ndarray
    rows: np.ndarray
    widths: Widths


@jit
def new_alone(parameters):
    """Room for one structure."""
    n, widths = parameters.influence.shape[0], of_one()
    return Alone(new_rows(n, widths.structure), new_rows(n * n, widths.structure), widths)


@jit
def solve_alone(dense, room, parameters, wanted, place):
    """Solve structure `first` of `count`, the two numbers of the place, by itself."""
    put_alone(dense, 0, parameters, place[0])
    see_modes(dense, parameters, wanted, room.widths)


class Together(NamedTuple):
    """Room for eigenproblems in lanes: as `Alone`, with all else; and whether M is diagonal."""

    values: np.ndarray
    rows: np.ndarray
    widths: Widths
    structures: StructureLanes
    is_diagonal: bool


@jit
def new_together(parameters):
    """Room for many structures."""
    n = parameters.influence.shape[0]
    structures, is_diagonal = new_structures(n, parameters.theta.shape[1]), all_diagonal(parameters.mass, n)
    return Together(structures.values, structures.rows, of_population(), structures, is_diagonal)


@jit
def solve_together(dense, room, parameters, wanted, place):
    """Solve structures `first` ... of `count`, together where that is possible."""
    (values, _, _, structures, is_diagonal), (first, count), lot = room, place, dense.lot
    for lane in range(lot.is_there.size):
        own = rows_of(parameters[:3], min(first + lane, count - 1))
        copy_entries(own[0], structures.theta[:, lane])
        is_given = is_finite(own[0]) and is_finite(own[1]) and is_finite(own[2])
        lot.is_there[lane] = first + lane < count and is_given
    solve_structures(structures, (parameters.mass, parameters.stiffness), is_diagonal)
    write_load(dense, structures.mass, parameters, is_diagonal)
    for lane in range(lot.is_there.size):
        is_good = structures.is_good[lane]
        for r in range(1, lot.n_modes if lot.at.shape[0] > 0 else 0):
            is_good &= values[r, lane] - values[r - 1, lane] > REPEATED * values[r, lane]
        if lot.is_there[lane] and not is_good:
            put_alone(dense, lane, parameters, first + lane)
    see_modes(dense, parameters, wanted, room.widths)


def solve(dense, room, parameters, wanted, place):
    """Solve structures `first` ... of `count`, for compiled code only."""


@overload(solve, inline="always")
def _solve(dense, room, parameters, wanted, place):
    solver = {Alone: solve_alone, Together: solve_together}[room.instance_class]
    return lambda dense, room, parameters, wanted, place: solver(dense, room, parameters, wanted, place)


@jit
def write_load(dense, mass, parameters, is_diagonal):
    """Write M influence - forces of all lanes, M by its lower half (n n, lanes)."""
    n, d = parameters.influence.shape
    for i in range(n):
        for j in range(d):
            total = splat(-parameters.forces[i, j])
            for k in range(i if is_diagonal else 0, i + 1 if is_diagonal else n):
                entry = load(mass, i * n + k if k <= i else k * n + i)
                total = total + entry * parameters.influence[k, j]
            store(dense.load, i * d + j, total)


@jit
def damp_modes(dense, parameters, first, highest):
    """Write the classical damping of the structures in the lanes."""
    for lane in range(dense.lot.is_there.size):
        if dense.lot.is_there[lane]:
            _, rayleigh, ratios = rows_of(parameters[:3], first + lane)
            put_damping(dense.lot, lane, rayleigh, ratios, NO_DAMPING, highest)


@jit
def evaluate_dense(parameters, excitation, wanted, observed, result, history, room):
    """Write the statistics (p, s, 1 or 4) of misfits, or the response of one structure into the history.

    Parameters
    ----------
    parameters : LinearParameters
        theta, rayleigh and ratios (p or 1, ...) have a row for each particle or one for all.
    excitation : Excitation
    wanted : Outputs
    observed : array (s, u)
        Data, or (0, 0) for a response.
    result : array (p, s, 1 or 4)
        NaN for no structure.
    history : array (s, u) or (0, 0)
    room : Alone or Together
    """
    s, n_times = wanted.sensors.shape[0], max(observed.shape[1], history.shape[1])
    widths, count, highest = room.widths, result.shape[0], highest_step(excitation)
    walk = new_walk(excitation, observed, n_times, wanted.n_modes, s, widths)
    dense = new_dense(parameters, excitation, wanted, False, room, walk.samples, widths)
    for first in range(0, count, dense.lot.is_there.size):
        solve(dense, room, parameters, wanted, (first, count))
        damp_modes(dense, parameters, first, highest)
        evaluate(dense.lot, walk, history, first, result, widths)
    if not dense.lot.is_there[0]:
        history[:] = np.nan


@jit
def dense_statistics(parameters, excitation, wanted, observed, n_statistics):
    """Statistics (p, s, 1 or 4) of the misfits of a population; NaN for no structure."""
    result = np.empty((n_structures(parameters), wanted.sensors.shape[0], n_statistics))
    room, nothing = new_together(parameters), np.empty((0, 0))
    evaluate_dense(parameters, excitation, wanted, observed, result, nothing, room)
    return result


@jit
def evaluate_structure(parameters, excitation, wanted, observed, history):
    """Statistics (s, 4) of the misfit of a population of one; or its response, unless there is no history."""
    data = observed if history.shape[0] == 0 else np.empty((0, 0))
    result = np.empty((1, wanted.sensors.shape[0], 4 if history.shape[0] == 0 else 1))
    room = new_alone(parameters)
    evaluate_dense(parameters, excitation, wanted, data, result, history, room)
    return result[0]


class DenseGradients(NamedTuple):
    """Room for gradients of structures in lanes, and what theta changes of them."""

    reduced: Reduced
    spread: Spread
    stiffness: Terms
    mass: Terms


@jit
def new_gradients(dense, parameters, widths):
    """Room for gradients."""
    n = parameters.influence.shape[0]
    return DenseGradients(
        new_reduced(dense.lot, widths),
        new_spread(dense.lot, parameters.theta.shape[1], False, widths),
        terms_of(parameters.stiffness, n),
        terms_of(parameters.mass, n),
    )


@jit
def add_gradients(dense, found, parameters, gradients, place, widths):
    """Add the derivatives of all lanes to gradients by theta, rayleigh and ratios; NaN for no structure."""
    (reduced, spread, stiffness, mass), lot, (first, count) = found, dense.lot, place
    spread_to_theta(lot, reduced, stiffness, mass, parameters.influence, spread, widths)
    for lane in range(min(lot.is_there.size, count - first)):
        by_theta, by_rayleigh, by_ratios = rows_of(gradients, first + lane)
        if lot.is_there[lane]:
            for k in range(by_theta.size):
                by_theta[k] += spread.by_theta[k, lane]
            add_damping(lot, reduced, lane, by_rayleigh, by_ratios)
        else:
            by_theta[:], by_rayleigh[:], by_ratios[:] = np.nan, np.nan, np.nan


@jit
def pull_back_dense(parameters, excitation, wanted, history, weights, is_given, gradients, room):
    """Add the gradients of structures to those by theta, rayleigh and ratios (p or 1, ...).

    The history (s, u) has data or, if `is_given`, derivatives by the response; weights (p, s, 1) are those of
    e_j. The others as in `evaluate_dense`.
    """
    widths, count, highest = room.widths, weights.shape[0], highest_step(excitation)
    walk = new_gradient_walk(excitation, history, is_given, False, wanted.n_modes, widths.wide, widths)
    dense = new_dense(parameters, excitation, wanted, True, room, walk.samples, widths)
    found = new_gradients(dense, parameters, widths)
    for first in range(0, count, dense.lot.is_there.size):
        solve(dense, room, parameters, wanted, (first, count))
        damp_modes(dense, parameters, first, highest)
        bring(dense.lot, walk, weights, first)
        derive(dense.lot, walk, found.reduced, widths)
        add_gradients(dense, found, parameters, gradients, (first, count), widths)


@jit
def add_dense_gradients(parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradients of a population by e_j alone, weights (p, s, 1)."""
    room = new_together(parameters)
    pull_back_dense(parameters, excitation, wanted, observed, weights, False, gradients, room)


@jit
def add_dense_gradient(parameters, excitation, wanted, history, weights, is_given, gradients):
    """Add the gradient of a population of one, by data or, if `is_given`, by derivatives by the response."""
    room = new_alone(parameters)
    pull_back_dense(parameters, excitation, wanted, history, weights, is_given, gradients, room)


@jit
def spread_population(parameters, excitation, wanted, sums, gradients):
    """Add the gradients of structures under one input from sums over time, without close modes."""
    count, m, s, widths = sums[0].shape[0], wanted.n_modes, wanted.sensors.shape[0], of_population()
    walk = new_walk(excitation, np.empty((0, 0)), 1, m, s, widths)
    room, highest = new_together(parameters), highest_step(excitation)
    dense = new_dense(parameters, excitation, wanted, True, room, walk.samples, widths)
    found = new_gradients(dense, parameters, widths)
    for first in range(0, count, dense.lot.is_there.size):
        solve_together(dense, room, parameters, wanted, (first, count))
        damp_modes(dense, parameters, first, highest)
        derive_from(dense.lot, sums, found.reduced, first, widths)
        add_gradients(dense, found, parameters, gradients, (first, count), widths)


@jit
def dense_systems(parameters, excitation, wanted, count):
    """`Systems` of dense structures with classical damping, of any inputs."""
    s, d, m, widths = wanted.sensors.shape[0], parameters.influence.shape[1], wanted.n_modes, of_population()
    systems, step = new_systems(count, s, m, d), excitation.dt / excitation.substeps
    walk = new_walk(excitation, np.empty((0, 0)), 1, m, s, widths)
    room, highest = new_together(parameters), highest_step(excitation)
    dense = new_dense(parameters, excitation, wanted, False, room, walk.samples, widths)
    lot = dense.lot
    for first in range(0, count, lot.is_there.size):
        solve_together(dense, room, parameters, wanted, (first, count))
        damp_modes(dense, parameters, first, highest)
        for lane in range(min(lot.is_there.size, count - first)):
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
