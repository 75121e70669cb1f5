"""Kernels of chains, see `families`: one chain is a population of one with its modes in the lanes.

Those of populations are called by Python, and share machine code; those of one chain are called from compiled
graphs as well.
"""

import numpy as np

from pymc_features.simulators.chain.modes import chain_modes
from pymc_features.simulators.chain.parameters import (
    ChainParameters,
    as_population,
    check_history,
    check_population,
    check_sizes,
    own_rows,
    zeros_like,
)
from pymc_features.simulators.chain.population import (
    new_modes,
    new_sensor_modes,
    solve_at_sensors,
    solve_modes,
    take_modes,
)
from pymc_features.simulators.compiled.arrays import positions, writable
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import n_outputs
from pymc_features.simulators.oscillators.evaluation import (
    NO_DATA,
    Changes,
    Structures,
    damp,
    evaluate_structures,
    pull_back_structures,
    pull_back_sums,
    systems_of,
)
from pymc_features.simulators.oscillators.march import in_rows
from pymc_features.simulators.oscillators.misfit import weigh_history
from pymc_features.simulators.oscillators.modal_lanes import clear
from pymc_features.simulators.oscillators.samples import of_one, of_population
from pymc_features.simulators.oscillators.spread import new_terms, put_term

# --- solving eigenproblems ----------------------------------------------------------------------------------


@jit
def put_modes(lot, lane, solved, wanted):
    """Write a chain with all its modes: omega, participation and mode shapes in rows."""
    (omega, participation, rows), (s, n) = solved, (wanted.sensors.size, lot.n_all)
    for r in range(n):
        lot.squares[r, lane], lot.participation[r, lane] = omega[r] * omega[r], participation[r]
        for j in range(s):
            lot.shapes[j * n + r, lane] = rows[r, wanted.sensors[j]]
    if lot.at.shape[0] > 0:
        for r in range(n):
            for i in range(n):
                lot.at[i * n + r, lane] = rows[r, i]
    lot.is_there[lane] = True


@jit
def put_alone(structures, lot, lane, p):
    """Solve chain p by itself; its lane is empty if there is none."""
    own, n = own_rows(structures.parameters, p), structures.influence.shape[0]
    omega, participation, rows = np.empty(n), np.empty(n), np.zeros((n, n))
    if chain_modes(own.mass, own.stiffness, omega, rows, participation):
        put_modes(lot, lane, (omega, participation, rows), structures.wanted)
    else:
        clear(lot, lane)


@jit
def put_seen(modes, wanted, lot, lane):
    """Write a chain whose modes are known at the sensors only."""
    s, n = wanted.sensors.size, lot.n_all
    order = np.empty(modes.values.shape[0], dtype=np.int64)
    positions(modes.values, lane, order)
    for r in range(n):
        row = order[r] * (s + 1)
        lot.squares[r, lane] = modes.values[order[r], lane]
        lot.participation[r, lane] = modes.vectors[row + s, lane]
        for j in range(s):
            lot.shapes[j * n + r, lane] = modes.vectors[row + j, lane]
    lot.is_there[lane] = True


@jit
def put_whole(modes, wanted, lot, lane):
    """Write a chain with all its modes."""
    n = lot.n_all
    omega, participation, rows = np.empty(n), np.empty(n), np.empty((n, n))
    take_modes(modes, lane, omega, participation, rows)
    put_modes(lot, lane, (omega, participation, rows), wanted)


@jit
def finish(structures, lot, place, highest):
    """Solve by themselves what could not be solved together, and write the damping of all."""
    first, count = place
    for lane in range(lot.is_there.size):
        if first + lane >= count:
            clear(lot, lane)
        elif not structures.room.valid[lane]:
            put_alone(structures, lot, lane, first + lane)
    damp(lot, structures.parameters, first, highest)


@jit
def solve_alone(structures, lot, place, highest):
    """Solve one chain."""
    put_alone(structures, lot, 0, place[0])
    damp(lot, structures.parameters, place[0], highest)


@jit
def solve_seen(structures, lot, place, highest):
    """Solve chains together, for the sensors."""
    (parameters, wanted, _, _, modes, _), (first, count) = structures, place
    solve_at_sensors(modes, parameters, wanted.sensors, first, min(lot.is_there.size, count - first))
    for lane in range(lot.is_there.size):
        if modes.valid[lane]:
            put_seen(modes, wanted, lot, lane)
    finish(structures, lot, place, highest)


@jit
def solve_whole(structures, lot, place, highest):
    """Solve chains together, with all modes and their shapes."""
    (parameters, wanted, _, _, modes, _), (first, count) = structures, place
    solve_modes(modes, parameters, first, min(lot.is_there.size, count - first))
    for lane in range(lot.is_there.size):
        if modes.valid[lane]:
            put_whole(modes, wanted, lot, lane)
    finish(structures, lot, place, highest)


@jit
def chains(parameters, wanted, room, widths):
    """`Structures` of rows of parameters."""
    influence, motion = np.ones((parameters.mass.shape[1], 1)), np.ones((wanted.sensors.size, 1))
    return Structures(parameters, wanted, influence, motion, room, widths)


@jit
def one_chain(parameters, wanted):
    """`Structures` of one chain, without room for others."""
    return chains(as_population(parameters), wanted, np.empty(0), of_one())


@jit
def changes_of(n):
    """What n masses, then n springs, change: of the stiffness drifts."""
    stiffness, mass = new_terms(n), new_terms(n)
    for i in range(n):
        put_term(mass, i, i, i, i, 1.0)
        put_term(stiffness, i, i, i, n + i, 1.0)
    return Changes(2 * n, stiffness, mass, True)


# --- populations --------------------------------------------------------------------------------------------


@jit
def evaluate_chains(parameters, excitation, wanted, observed, result, history):
    """Write the statistics of a population, or the response of one, see `evaluation`."""
    if history.shape[0] == 0:
        check_population(parameters, excitation, wanted, observed)
    else:
        check_sizes(own_rows(parameters, 0), wanted)
    room = new_sensor_modes(parameters.mass.shape[1], wanted.sensors.size)
    structures = chains(parameters, wanted, room, of_population())
    evaluate_structures(solve_seen, structures, in_rows(excitation), observed, result, history)


@jit
def add_chain_gradients(parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradients by e_j alone, weights (p, s, 1), of a population."""
    check_population(parameters, excitation, wanted, observed)
    n, data = parameters.mass.shape[1], (observed, weights, False)
    structures = chains(parameters, wanted, new_modes(n), of_population())
    pull_back_structures(solve_whole, structures, changes_of(n), in_rows(excitation), data, gradients)


def chain_history(parameters, excitation, wanted) -> np.ndarray:
    """`chain_response` by the machine code of populations."""
    n_sensors, rows = np.size(wanted.sensors), ChainParameters(*(writable(x)[None] for x in parameters))
    total = n_outputs.py_func(np.size(excitation.acceleration), excitation.substeps, excitation.stride)
    result, history = np.empty((1, n_sensors, 1)), np.empty((n_sensors, total))
    evaluate_chains(rows, excitation, wanted, NO_DATA, result, history)
    return history


def population_statistics(parameters, excitation, wanted, observed, n_statistics) -> np.ndarray:
    """Statistics (p, s, 1 or 4) of the misfits of a population; NaN where there is no structure."""
    result = np.empty((max(map(len, parameters)), len(observed), n_statistics))
    evaluate_chains(parameters, excitation, wanted, observed, result, np.empty((0, 0)))
    return result


def population_discrepancy(parameters, excitation, wanted, observed) -> np.ndarray:
    """e_j (p, s) of Eq. (3) for a population; NaN in the rows whose parameters describe no structure.

    Parameters
    ----------
    parameters : ChainParameters
        Each array has a row for each particle, or one for all.
    excitation, wanted, observed
        Common to all, as in `chain_discrepancy`.

    Notes
    -----
    One thread. Memory: the result, the record and one block of 16 samples for 4 or 8 particles. Agrees with
    `chain_discrepancy` to 1e-12.
    """
    return population_statistics(parameters, excitation, wanted, observed, 1)[:, :, 0].copy()


def population_misfit(parameters, excitation, wanted, observed) -> np.ndarray:
    """What `chain_misfit` returns, for a population: an array (p, s, 4)."""
    return population_statistics(parameters, excitation, wanted, observed, 4)


def population_gradient(parameters, excitation, wanted, observed, weights) -> ChainParameters:
    """Gradient of sum_pjq weights_pjq statistics_pjq of a population; what all particles share gets the sum.

    Parameters as in `population_misfit`, and `weights` (p, s, 1) or (p, s, 4). Returns arrays of the shapes
    of the parameters.
    """
    gradients = ChainParameters(*map(np.zeros_like, parameters))
    if weights.shape[2] == 1:
        add_chain_gradients(parameters, excitation, wanted, observed, weights, gradients)
        return gradients
    for p, own_weights in enumerate(weights):
        own = own_rows.py_func(parameters, p)
        parts = misfit_gradient(own, excitation, wanted, observed, own_weights)
        for total, part in zip(gradients, parts, strict=True):
            total[p % len(total)] += part
    return gradients


@jit
def chain_systems(parameters, excitation, wanted, observed):
    """`Systems` of all particles, for the tables of `long_records`.

    Parameters as of `population_discrepancy`; of the data their shape.
    """
    count = check_population(parameters, excitation, wanted, observed)
    room = new_sensor_modes(parameters.mass.shape[1], wanted.sensors.size)
    structures = chains(parameters, wanted, room, of_population())
    return systems_of(solve_seen, structures, in_rows(excitation), count)


@jit
def add_gradients_of_sums(parameters, excitation, wanted, sums, gradients):
    """Add the gradients of a population of which the sums over time are known."""
    n = parameters.mass.shape[1]
    structures = chains(parameters, wanted, new_modes(n), of_population())
    pull_back_sums(solve_whole, structures, changes_of(n), in_rows(excitation), sums, gradients)


def chain_gradient_of_sums(parameters, excitation, wanted, sums) -> ChainParameters:
    """Gradients of a population of which the sums over time are known, see `reduction.derive_from`.

    No two modes of a chain may be close. Parameters and results as in `population_gradient`.
    """
    gradients = ChainParameters(*map(np.zeros_like, parameters))
    add_gradients_of_sums(parameters, excitation, wanted, sums, gradients)
    return gradients


# --- one chain ----------------------------------------------------------------------------------------------


@jit
def write_history(parameters, excitation, wanted, history):
    """Write the response (s, u) of a chain."""
    structures, inputs = one_chain(parameters, wanted), in_rows(excitation)
    result = np.empty((1, wanted.sensors.size, 1))
    evaluate_structures(solve_alone, structures, inputs, np.empty((0, 0)), result, history)


@jit
def chain_response(parameters, excitation, wanted):
    """Response history (s, u) of a spring-mass chain, exact for an excitation linear between its samples.

    Parameters
    ----------
    parameters : ChainParameters
    excitation : Excitation
    wanted : Outputs

    Returns
    -------
    array (s, u)
        All NaN where the parameters describe no structure.
    """
    check_sizes(parameters, wanted)
    total = n_outputs(excitation.acceleration.size, excitation.substeps, excitation.stride)
    history = np.empty((wanted.sensors.size, total))
    write_history(parameters, excitation, wanted, history)
    return history


@jit
def chain_statistics(parameters, excitation, wanted, observed, n_statistics):
    """Statistics (s, 1 or 4) of the misfit of a chain; NaN where there is no structure."""
    check_sizes(parameters, wanted)
    check_history(observed, excitation, wanted)
    result = np.empty((1, observed.shape[0], n_statistics))
    structures, inputs = one_chain(parameters, wanted), in_rows(excitation)
    evaluate_structures(solve_alone, structures, inputs, observed, result, np.empty((0, 0)))
    return result[0]


@jit
def chain_discrepancy(parameters, excitation, wanted, observed):
    """e_j = (1/N_D) sum_k [y_j(k) - g_j(k; theta)]^2 (s,), Eq. (3), of data (s, u) in its unit."""
    return chain_statistics(parameters, excitation, wanted, observed, 1)[:, 0].copy()


@jit
def chain_misfit(parameters, excitation, wanted, observed):
    """What the log-density of errors correlated in time needs of the misfit r = y - g: (s, 4).

    e_j, the sum of the squared increments r(k) - r(k - 1) over N_D, the first misfit and the last.
    """
    return chain_statistics(parameters, excitation, wanted, observed, 4)


@jit
def chain_gradient(parameters, excitation, wanted, history, weights, is_given):
    """Gradient of one chain; the history has data or, if `is_given`, derivatives by the response.

    `weights` (s, 1) are those of e_j.
    """
    check_sizes(parameters, wanted)
    check_history(history, excitation, wanted)
    found, changes = zeros_like(parameters), changes_of(parameters.mass.size)
    data = history, weights.reshape((1, *weights.shape)), is_given
    structures, inputs = one_chain(parameters, wanted), in_rows(excitation)
    pull_back_structures(solve_alone, structures, changes, inputs, data, as_population(found))
    return found


@jit
def response_gradient(parameters, excitation, wanted, cotangent):
    """Gradient of sum_jk W_jk y_jk, W the `cotangent` (s, u), by the parameters: arrays of their shapes."""
    weights = np.zeros((wanted.sensors.size, 1))
    return chain_gradient(parameters, excitation, wanted, cotangent, weights, True)


@jit
def misfit_gradient(parameters, excitation, wanted, observed, weights):
    """Gradient of sum_jq weights_jq statistics_jq, of the first (s, 1) or all (s, 4) of `chain_misfit`.

    For all of them the response is kept.
    """
    history, is_given = observed, weights.shape[1] > 1
    if is_given:
        history = np.empty(observed.shape)
        write_history(parameters, excitation, wanted, history)
        weigh_history(history, observed, weights)
    return chain_gradient(parameters, excitation, wanted, history, weights[:, :1].copy(), is_given)


@jit
def discrepancy_gradient(parameters, excitation, wanted, observed, weights):
    """`misfit_gradient` by weights (s, 1) of e_j alone, which needs no response and compiles in less time."""
    return chain_gradient(parameters, excitation, wanted, observed, weights, False)
