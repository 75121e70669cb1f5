"""Gradients of dense structures with classical damping in compiled code: of one, or of a population.

The same chain rule as in `projection`, by all n modes of the structure at hand.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.linear.dense_population import solve_dense
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION
from pymc_features.simulators.oscillators.gradient import modal_gradient
from pymc_features.simulators.oscillators.modal_system import DampingLaw, ModalSystem
from pymc_features.simulators.oscillators.outside import outside_span


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
    grad_theta, grad_rayleigh, grad_ratios = gradients
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
def add_population_gradient(parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradients of all particles; what they share, in one row, gets the sum.

    theta, rayleigh and ratios, and `gradients` of their shapes, have one more axis in front; `weights` are
    (p, s, 1) or (p, s, 4).
    """
    theta, rayleigh, ratios = parameters.theta, parameters.rayleigh, parameters.ratios
    grad_theta, grad_rayleigh, grad_ratios = gradients
    for p in range(weights.shape[0]):
        i, j, k = p % theta.shape[0], p % rayleigh.shape[0], p % ratios.shape[0]
        own, own_gradients = (
            (theta[i], rayleigh[j], ratios[k]),
            (grad_theta[i], grad_rayleigh[j], grad_ratios[k]),
        )
        add_gradient(parameters, own, excitation, wanted, observed, weights[p], own_gradients)
