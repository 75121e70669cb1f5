"""Kernels of chains, see `families`: one chain is a population of one with its modes in the lanes.

Chains in lanes: their modes, misfits, responses and gradients, of many chains and of one.
"""

import numpy as np

from pymc_features.simulators.chain.modes import chain_modes
from pymc_features.simulators.chain.parameters import check_history, check_sizes, own_rows, zeros_like
from pymc_features.simulators.chain.population import (
    check_population,
    new_modes,
    new_sensor_modes,
    solve_at_sensors,
    solve_modes,
    take_modes,
)
from pymc_features.simulators.compiled.arrays import positions
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.long_records.systems import new_systems, put_modes
from pymc_features.simulators.oscillators.arguments import n_outputs
from pymc_features.simulators.oscillators.march import evaluate, in_rows, new_walk
from pymc_features.simulators.oscillators.misfit import weigh_history
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
from pymc_features.simulators.oscillators.spread import (
    add_damping,
    new_spread,
    new_terms,
    put_term,
    spread_to_theta,
)
from pymc_features.simulators.oscillators.sums import new_gradient_walk


@jit
def put_chain_modes(lot, lane, solved, own, wanted, highest):
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
    put_damping(lot, lane, own.rayleigh, own.ratios, NO_DAMPING, highest)


@jit
def put_chain(lot, lane, own, wanted, highest):
    """Solve a chain by itself and write it into a lane."""
    n = own.mass.size
    omega, participation, rows = np.empty(n), np.empty(n), np.zeros((n, n))
    if chain_modes(own.mass, own.stiffness, omega, rows, participation):
        put_chain_modes(lot, lane, (omega, participation, rows), own, wanted, highest)
    else:
        clear(lot, lane)


@jit
def put_at_sensors(lot, lane, modes, order, own, wanted, highest):
    """Write a chain whose modes are known at the sensors only."""
    s, n = wanted.sensors.size, lot.n_all
    positions(modes.values, lane, order)
    for r in range(n):
        row = order[r] * (s + 1)
        lot.squares[r, lane], lot.participation[r, lane] = (
            modes.values[order[r], lane],
            modes.vectors[row + s, lane],
        )
        for j in range(s):
            lot.shapes[j * n + r, lane] = modes.vectors[row + j, lane]
    put_damping(lot, lane, own.rayleigh, own.ratios, NO_DAMPING, highest)


@jit
def new_lanes(n, m, excitation, wanted, with_gradients, samples, widths):
    """Lanes for chains of n masses."""
    s, step = wanted.sensors.size, excitation.dt / excitation.substeps
    sizes, request = (n, n if with_gradients else m, m, s), (step, wanted.quantity)
    return new_modal_lanes(sizes, np.ones((s, 1)), (with_gradients, False), samples, request, widths)


@jit
def chain_statistics(parameters, excitation, wanted, observed, n_statistics):
    """Statistics (p, s, 1 or 4) of the misfits of a population; NaN where there is no structure."""
    count, widths = check_population(parameters, excitation, wanted, observed), of_population()
    n, (s, n_times), m = parameters.mass.shape[1], observed.shape, wanted.n_modes
    walk = new_walk(in_rows(excitation), observed, n_times, m, s, widths)
    lot = new_lanes(n, m, excitation, wanted, False, walk.samples, widths)
    result, modes, lots = np.empty((count, s, n_statistics)), new_sensor_modes(n, s), lot.is_there.size
    order, highest, history = np.empty(n, dtype=np.int64), highest_step(excitation), np.empty((0, 0))
    for first in range(0, count, lots):
        solve_at_sensors(modes, parameters, wanted.sensors, first, min(lots, count - first))
        for lane in range(lots):
            own = own_rows(parameters, min(first + lane, count - 1))
            if first + lane >= count:
                clear(lot, lane)
            elif modes.valid[lane]:
                put_at_sensors(lot, lane, modes, order, own, wanted, highest)
            else:
                put_chain(lot, lane, own, wanted, highest)
        evaluate(lot, walk, history, first, result, widths)
    return result


@jit
def evaluate_chain(parameters, excitation, wanted, observed, n_statistics, history):
    """Statistics (s, 1 or 4) of the misfit of a chain; its response instead, unless the history is empty."""
    check_sizes(parameters, wanted)
    if history.shape[0] == 0:
        check_history(observed, excitation, wanted)
    n, s, m, widths = parameters.mass.size, wanted.sensors.size, wanted.n_modes, of_one()
    n_times = max(observed.shape[1], history.shape[1])
    walk = new_walk(in_rows(excitation), observed, n_times, m, s, widths)
    lot = new_lanes(n, m, excitation, wanted, False, walk.samples, widths)
    result = np.full((1, s, n_statistics), np.nan)
    put_chain(lot, 0, parameters, wanted, highest_step(excitation))
    if lot.is_there[0]:
        evaluate(lot, walk, history, 0, result, widths)
    else:
        history[:] = np.nan
    return result[0]


@jit
def terms_of_chain(n):
    """Terms of the stiffness, in drifts, and of the mass for parameters that are n masses, then n springs."""
    stiffness, mass = new_terms(n), new_terms(n)
    for i in range(n):
        put_term(mass, i, i, i, i, 1.0)
        put_term(stiffness, i, i, i, n + i, 1.0)
    return stiffness, mass


@jit
def add_lane(lot, reduced, spread, lane, gradients):
    """Add the derivatives of one lane to the gradients of its chain; NaN where there is none."""
    n = gradients.mass.size
    if not lot.is_there[lane]:
        for gradient in gradients:
            gradient[:] = np.nan
        return
    for i in range(n):
        gradients.mass[i] += spread.by_theta[i, lane]
        gradients.stiffness[i] += spread.by_theta[n + i, lane]
    add_damping(lot, reduced, lane, gradients.rayleigh, gradients.ratios)


@jit
def solve_lanes(lot, modes, parameters, first, count, wanted, highest):
    """Solve chains `first` ... with all their modes, together where that is possible."""
    n, lots = lot.n_all, lot.is_there.size
    omega, participation, rows = np.empty(n), np.empty(n), np.empty((n, n))
    solve_modes(modes, parameters, first, min(lots, count - first))
    for lane in range(lots):
        own = own_rows(parameters, min(first + lane, count - 1))
        if first + lane >= count:
            clear(lot, lane)
        elif modes.valid[lane]:
            take_modes(modes, lane, omega, participation, rows)
            put_chain_modes(lot, lane, (omega, participation, rows), own, wanted, highest)
        else:
            put_chain(lot, lane, own, wanted, highest)


@jit
def add_chain_gradients(parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradients by e_j alone, weights (p, s, 1), of a population of chains."""
    n, m, count, widths = parameters.mass.shape[1], wanted.n_modes, weights.shape[0], of_population()
    walk = new_gradient_walk(in_rows(excitation), observed, False, False, m, widths.wide, widths)
    lot = new_lanes(n, m, excitation, wanted, True, walk.samples, widths)
    reduced, spread, modes = new_reduced(lot, widths), new_spread(lot, 2 * n, True, widths), new_modes(n)
    (stiffness, mass), influence, lots = terms_of_chain(n), np.ones((n, 1)), lot.is_there.size
    for first in range(0, count, lots):
        solve_lanes(lot, modes, parameters, first, count, wanted, highest_step(excitation))
        bring(lot, walk, weights, first)
        derive(lot, walk, reduced, widths)
        spread_to_theta(lot, reduced, stiffness, mass, influence, spread, widths)
        for lane in range(min(lots, count - first)):
            add_lane(lot, reduced, spread, lane, own_rows(gradients, first + lane))


@jit
def add_chain_gradient(parameters, excitation, wanted, history, weights, is_given, gradients):
    """Add the gradient of one chain; the history has data or, if `is_given`, derivatives by the response.

    `weights` (s, 1) are those of e_j.
    """
    check_sizes(parameters, wanted)
    check_history(history, excitation, wanted)
    n, m, widths = parameters.mass.size, wanted.n_modes, of_one()
    walk = new_gradient_walk(in_rows(excitation), history, is_given, False, m, widths.wide, widths)
    lot = new_lanes(n, m, excitation, wanted, True, walk.samples, widths)
    reduced, spread = new_reduced(lot, widths), new_spread(lot, 2 * n, True, widths)
    stiffness, mass = terms_of_chain(n)
    put_chain(lot, 0, parameters, wanted, highest_step(excitation))
    if lot.is_there[0]:
        bring(lot, walk, weights.reshape((1, *weights.shape)), 0)
        derive(lot, walk, reduced, widths)
        spread_to_theta(lot, reduced, stiffness, mass, np.ones((n, 1)), spread, widths)
    add_lane(lot, reduced, spread, 0, gradients)


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
    total = n_outputs(excitation.acceleration.size, excitation.substeps, excitation.stride)
    history = np.empty((wanted.sensors.size, total))
    evaluate_chain(parameters, excitation, wanted, np.empty((0, 0)), 1, history)
    return history


@jit
def chain_discrepancy(parameters, excitation, wanted, observed):
    """e_j = (1/N_D) sum_k [y_j(k) - g_j(k; theta)]^2 (s,), Eq. (3), of data (s, u) in its unit."""
    return evaluate_chain(parameters, excitation, wanted, observed, 1, np.empty((0, 0)))[:, 0].copy()


@jit
def chain_misfit(parameters, excitation, wanted, observed):
    """What the log-density of errors correlated in time needs of the misfit r = y - g: (s, 4).

    e_j, the sum of the squared increments r(k) - r(k - 1) over N_D, the first misfit and the last.
    """
    return evaluate_chain(parameters, excitation, wanted, observed, 4, np.empty((0, 0)))


@jit
def population_discrepancy(parameters, excitation, wanted, observed):
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
    return chain_statistics(parameters, excitation, wanted, observed, 1)[:, :, 0].copy()


@jit
def population_misfit(parameters, excitation, wanted, observed):
    """What `chain_misfit` returns, for a population: an array (p, s, 4)."""
    return chain_statistics(parameters, excitation, wanted, observed, 4)


@jit
def response_gradient(parameters, excitation, wanted, cotangent):
    """Gradient of sum_jk W_jk y_jk, W the `cotangent` (s, u), by the parameters: arrays of their shapes."""
    gradients = zeros_like(parameters)
    weights = np.zeros((wanted.sensors.size, 1))
    add_chain_gradient(parameters, excitation, wanted, cotangent, weights, True, gradients)
    return gradients


@jit
def add_misfit_gradient(parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradient by the first statistic (s, 1), or by all (s, 4): for these the response is kept."""
    history, is_given = observed, weights.shape[1] > 1
    if is_given:
        history = np.empty(observed.shape)
        evaluate_chain(parameters, excitation, wanted, np.empty((0, 0)), 1, history)
        weigh_history(history, observed, weights)
    own = weights[:, :1].copy()
    add_chain_gradient(parameters, excitation, wanted, history, own, is_given, gradients)


@jit
def misfit_gradient(parameters, excitation, wanted, observed, weights):
    """Gradient of sum_jq weights_jq statistics_jq, of the first (s, 1) or all (s, 4) of `chain_misfit`."""
    gradients = zeros_like(parameters)
    add_misfit_gradient(parameters, excitation, wanted, observed, weights, gradients)
    return gradients


@jit
def population_gradient(parameters, excitation, wanted, observed, weights):
    """Gradient of sum_pjq weights_pjq statistics_pjq of a population; what all particles share gets the sum.

    Parameters as in `population_misfit`, and `weights` (p, s, 1) or (p, s, 4). Returns arrays of the shapes
    of the parameters.
    """
    gradients = zeros_like(parameters)
    check_population(parameters, excitation, wanted, observed)
    if weights.shape[2] == 1:
        add_chain_gradients(parameters, excitation, wanted, observed, weights, gradients)
        return gradients
    for p in range(weights.shape[0]):
        own, own_gradients = own_rows(parameters, p), own_rows(gradients, p)
        add_misfit_gradient(own, excitation, wanted, observed, weights[p], own_gradients)
    return gradients


@jit
def discrepancy_gradient(parameters, excitation, wanted, observed, weights):
    """`misfit_gradient` by weights (s, 1) of e_j alone, which needs no response and compiles in less time."""
    gradients = zeros_like(parameters)
    add_chain_gradient(parameters, excitation, wanted, observed, weights, False, gradients)
    return gradients


@jit
def population_discrepancy_gradient(parameters, excitation, wanted, observed, weights):
    """`population_gradient` by weights (p, s, 1) of e_j alone."""
    gradients = zeros_like(parameters)
    check_population(parameters, excitation, wanted, observed)
    add_chain_gradients(parameters, excitation, wanted, observed, weights, gradients)
    return gradients


@jit
def chain_systems(parameters, excitation, wanted, observed):
    """`Systems` of all particles, for the tables of `long_records`.

    Parameters as of `population_discrepancy`; of the data their shape.
    """
    count, widths = check_population(parameters, excitation, wanted, observed), of_population()
    (sensors, m, _), n, step = wanted, parameters.mass.shape[1], excitation.dt / excitation.substeps
    walk = new_walk(in_rows(excitation), np.empty((0, 0)), 1, m, sensors.size, widths)
    lot = new_lanes(n, m, excitation, wanted, False, walk.samples, widths)
    systems, modes = new_systems(count, sensors.size, m, 1), new_sensor_modes(n, sensors.size)
    order, highest, lots = np.empty(n, dtype=np.int64), highest_step(excitation), lot.is_there.size
    for first in range(0, count, lots):
        solve_at_sensors(modes, parameters, sensors, first, min(lots, count - first))
        for lane in range(min(lots, count - first)):
            lot.is_there[lane] = False
            if modes.valid[lane]:
                put_at_sensors(lot, lane, modes, order, own_rows(parameters, first + lane), wanted, highest)
            if lot.is_there[lane]:
                system, feed = system_of(lot, lane)
                if not has_fast(system, step, highest):
                    put_modes(systems, first + lane, system, feed)
    return systems


@jit
def chain_gradient_of_sums(parameters, excitation, wanted, sums):
    """Gradients of a population of which the sums over time are known, see `reduction.derive_from`.

    No two modes of a chain may be close. Parameters and results as in `population_gradient`.
    """
    gradients, n, count, widths = (
        zeros_like(parameters),
        parameters.mass.shape[1],
        sums[0].shape[0],
        of_population(),
    )
    walk = new_walk(in_rows(excitation), np.empty((0, 0)), 1, wanted.n_modes, wanted.sensors.size, widths)
    lot = new_lanes(n, wanted.n_modes, excitation, wanted, True, walk.samples, widths)
    reduced, spread, modes = new_reduced(lot, widths), new_spread(lot, 2 * n, True, widths), new_modes(n)
    (stiffness, mass), influence, lots = terms_of_chain(n), np.ones((n, 1)), lot.is_there.size
    for first in range(0, count, lots):
        solve_lanes(lot, modes, parameters, first, count, wanted, highest_step(excitation))
        derive_from(lot, sums, reduced, first, widths)
        spread_to_theta(lot, reduced, stiffness, mass, influence, spread, widths)
        for lane in range(min(lots, count - first)):
            add_lane(lot, reduced, spread, lane, own_rows(gradients, first + lane))
    return gradients
