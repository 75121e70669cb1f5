"""Modes of dense structures with classical damping, and their gradients, in compiled code."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.eigen.outside import outside_span
from pymc_features.simulators.linear.dense import solve_dense
from pymc_features.simulators.modal.perturbation import (
    Cotangent,
    by_eigenvalues,
    reduced_cotangents,
    write_modes,
)


@jit
def dense_population_modes(parameters, wanted):
    """Frequencies (p, m), shapes (p, m, s) and damping ratios (p, m) of dense `LinearParameters`."""
    theta, rayleigh, ratios = parameters.theta, parameters.rayleigh, parameters.ratios
    count, m = max(theta.shape[0], rayleigh.shape[0], ratios.shape[0]), wanted.n_modes
    frequencies, damping_ratios = np.full((count, m), np.nan), np.full((count, m), np.nan)
    shapes = np.full((count, m, wanted.sensors.size), np.nan)
    for p in range(count):
        own = theta[p % theta.shape[0]], rayleigh[p % rayleigh.shape[0]], ratios[p % ratios.shape[0]]
        valid, omega, rows, damping, _ = solve_dense(parameters, own, 0.0, m, m)
        if valid:
            write_modes((omega, rows, damping), wanted.sensors, frequencies[p], shapes[p], damping_ratios[p])
    return frequencies, shapes, damping_ratios


@jit
def add_modes_gradient(parameters, own, wanted, cotangent, gradients):
    """Add the gradient of one structure to `gradients`; NaN where its parameters describe none.

    `own` and `gradients` are theta (p,), rayleigh (2,) and ratios (k,); the matrices are those of
    `parameters`.
    """
    n, m, (_, rayleigh, _) = parameters.influence.shape[0], wanted.n_modes, own
    grad_theta, grad_rayleigh, grad_ratios = gradients
    valid, omega, rows, damping, _ = solve_dense(parameters, own, 0.0, n, m)
    if not valid:
        for gradient in gradients:
            gradient[:] = np.nan
        return
    kept, slopes, by_shapes = omega[:m].copy(), np.empty(m), np.zeros((n, m))
    for r in range(m):
        slopes[r] = 0.5 * (rayleigh[1] - rayleigh[0] / kept[r] ** 2)
        if cotangent.ratios[r] != 0.0:
            grad_rayleigh[0] += cotangent.ratios[r] / (2.0 * kept[r])
            grad_rayleigh[1] += cotangent.ratios[r] * 0.5 * kept[r]
            grad_ratios[r] += cotangent.ratios[r]
        for j in range(wanted.sensors.size):
            by_shapes[wanted.sensors[j], r] += cotangent.shapes[r, j]
    by_eigenvalue = by_eigenvalues(kept, slopes, cotangent)
    by_stiffness, by_mass = reduced_cotangents(kept, by_eigenvalue, np.dot(rows[:m], by_shapes))
    shapes = np.ascontiguousarray(rows[:m].T)
    left_stiffness, left_mass = np.dot(shapes, by_stiffness), np.dot(shapes, by_mass)
    if m < n:
        outside = outside_span(omega, rows, m, by_shapes)
        left_stiffness -= outside
        left_mass += outside * kept**2
    if parameters.stiffness.shape[0] > 1:
        grad_theta += np.dot(parameters.stiffness[1:], np.dot(left_stiffness, rows[:m]).reshape(n * n))
    if parameters.mass.shape[0] > 1:
        grad_theta += np.dot(parameters.mass[1:], np.dot(left_mass, rows[:m]).reshape(n * n))


@jit
def add_dense_gradients(parameters, wanted, cotangent, gradients):
    """Add the gradients of all particles; theta, rayleigh and ratios have a row for each or one for all."""
    theta, rayleigh, ratios = parameters.theta, parameters.rayleigh, parameters.ratios
    grad_theta, grad_rayleigh, grad_ratios = gradients
    for p in range(cotangent.frequencies.shape[0]):
        i, j, k = p % theta.shape[0], p % rayleigh.shape[0], p % ratios.shape[0]
        own, own_gradients = (
            (theta[i], rayleigh[j], ratios[k]),
            (grad_theta[i], grad_rayleigh[j], grad_ratios[k]),
        )
        by_modes = Cotangent(cotangent.frequencies[p], cotangent.shapes[p], cotangent.ratios[p])
        add_modes_gradient(parameters, own, wanted, by_modes, own_gradients)
