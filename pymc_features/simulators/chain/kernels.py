"""Kernels of chains, see `families`: one chain is a population of one with its modes in the lanes."""

import numpy as np

from pymc_features.simulators.chain.parameters import own_rows, zeros_like
from pymc_features.simulators.chain.population import check_population, new_modes
from pymc_features.simulators.chain.sensor_modes import new_sensor_modes, solve_at_sensors
from pymc_features.simulators.chain.structures import (
    add_chain_gradient,
    add_chain_gradients,
    add_lane,
    chain_statistics,
    evaluate_chain,
    new_lanes,
    put_at_sensors,
    solve_lanes,
    terms_of_chain,
)
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.long_records.systems import new_systems, put_modes
from pymc_features.simulators.oscillators.arguments import n_outputs
from pymc_features.simulators.oscillators.evaluation import in_rows, new_walk
from pymc_features.simulators.oscillators.fast_modes import has_fast, highest_step
from pymc_features.simulators.oscillators.misfit import weigh_history
from pymc_features.simulators.oscillators.modal_lanes import system_of
from pymc_features.simulators.oscillators.reduction import derive_from, new_reduced
from pymc_features.simulators.oscillators.samples import of_population
from pymc_features.simulators.oscillators.spread import new_spread, spread_to_theta


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
