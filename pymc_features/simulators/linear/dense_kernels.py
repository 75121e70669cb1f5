"""Gradients of dense structures with classical damping, as `linear.gradient` takes them."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.eigen.coupled import all_columns
from pymc_features.simulators.eigen.matrices import all_diagonal
from pymc_features.simulators.eigen.structures import new_structures
from pymc_features.simulators.linear.dense_structures import (
    add_dense_gradient,
    add_dense_gradients,
    add_lane,
    evaluate_structure,
    new_lanes,
    rows_of,
    solve_lanes,
)
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION
from pymc_features.simulators.oscillators.evaluation import new_walk
from pymc_features.simulators.oscillators.fast_modes import highest_step
from pymc_features.simulators.oscillators.misfit import weigh_history
from pymc_features.simulators.oscillators.reduction import derive_from, new_reduced
from pymc_features.simulators.oscillators.samples import of_population
from pymc_features.simulators.oscillators.spread import new_spread, spread_to_theta, terms_of


@jit
def is_share_known(parameters, wanted):
    """Whether what stands before the inputs in the response is the same for all parameters."""
    is_acceleration = wanted.quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION)
    is_moved = wanted.n_modes == parameters.influence.shape[0] and not np.any(parameters.forces != 0.0)
    return is_moved or not is_acceleration


@jit
def add_misfit_gradient(parameters, own, excitation, wanted, observed, weights, gradients):
    """Add the gradient by the first statistic (s, 1), or by all (s, 4): for these the response is kept."""
    history, is_given = observed, weights.shape[1] > 1
    if is_given:
        history = np.empty(observed.shape)
        evaluate_structure(parameters, own, excitation, wanted, observed, history)
        weigh_history(history, observed, weights)
    first = weights[:, :1].copy()
    add_dense_gradient(parameters, own, excitation, wanted, history, first, is_given, gradients)


@jit
def add_population_gradient(parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradients of all particles; what they share, in one row, gets the sum.

    theta, rayleigh and ratios, and `gradients` of their shapes, have one more axis in front; `weights` are
    (p, s, 1) or (p, s, 4).
    """
    if weights.shape[2] == 1 and excitation.acceleration.shape[0] == 1:
        add_dense_gradients(parameters, excitation, wanted, observed, weights, gradients)
        return
    for p in range(weights.shape[0]):
        own, own_gradients = rows_of(parameters[:3], p), rows_of(gradients, p)
        add_misfit_gradient(parameters, own, excitation, wanted, observed, weights[p], own_gradients)


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
