"""Gradient of the response of a chain, and of its misfit, by masses, springs and damping; and its transpose.

Between the chain's parameters and its modes: K = sum_i k_i d_i d_i' with the drift d_i' x = x_i - x_{i-1} of
spring i, M = diag(m), load M 1. What the modes do over time is the matter of `oscillators.gradient`.
"""

import numpy as np

from pymc_features.simulators.chain.parameters import ChainParameters
from pymc_features.simulators.chain.response import (
    check_history,
    check_sizes,
    ground_motion,
    modes_of,
)
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.eigen.outside import outside_span
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION, n_outputs
from pymc_features.simulators.oscillators.gradient import modal_gradient
from pymc_features.simulators.oscillators.modal_system import DampingLaw
from pymc_features.simulators.oscillators.recursion import modal_damping
from pymc_features.simulators.oscillators.tangent import ModalChange, march_change


@jit
def drifts_of(shapes):
    """Drifts (n, k) of the springs in the columns of displacements (n, k)."""
    drifts = shapes.copy()
    drifts[1:] -= shapes[:-1]
    return drifts


@jit
def relative_feed(wanted):
    """What stands before the ground acceleration, (s, 1), beside modal outputs that are relative to it."""
    return np.full((wanted.sensors.size, 1), 1.0 if wanted.quantity == ABSOLUTE_ACCELERATION else 0.0)


@jit
def add_gradient(parameters, excitation, wanted, history, weights, gradients):
    """Add the gradient for one set of parameters to `gradients`; NaN where they describe no structure.

    Parameters
    ----------
    parameters, gradients : ChainParameters
    excitation : Excitation
    wanted : Outputs
    history, weights
        As in `oscillators.gradient.sum_histories`.
    """
    check_sizes(parameters, wanted)
    check_history(history, excitation, wanted)
    valid, system, omega, rows = modes_of(parameters, excitation.dt / excitation.substeps, wanted)
    if not valid:
        for gradient in gradients:
            gradient[:] = np.nan
        return
    law = DampingLaw(parameters.rayleigh, parameters.ratios)
    feed, motion = relative_feed(wanted), ground_motion(excitation)
    found = modal_gradient(system, law, feed, motion, wanted.quantity, history, weights)
    spread_gradient(parameters, wanted, omega, rows, found, gradients)


@jit
def spread_gradient(parameters, wanted, omega, rows, found, gradients):
    """Add a `ModalGradient`, carried on to the parameters, to `gradients`; the modes as from `modes_of`."""
    m = wanted.n_modes
    shapes, load = np.ascontiguousarray(rows[:m].T), np.dot(rows[:m].T, found.load)
    left_stiffness, left_mass = np.dot(shapes, found.stiffness), np.dot(shapes, found.mass)
    if m < omega.size:
        outside = np.outer(parameters.mass, found.load)  # load M 1 times (dL/d(Phi' L))'
        for j in range(wanted.sensors.size):
            outside[wanted.sensors[j]] += found.shapes[j]
        outside = outside_span(omega, rows, m, outside)
        left_stiffness -= outside
        left_mass += outside * omega[:m] ** 2
    drifts, turned = drifts_of(shapes), drifts_of(left_stiffness)
    for i in range(omega.size):
        gradients.mass[i] += load[i, 0]
        for r in range(m):
            gradients.stiffness[i] += turned[i, r] * drifts[i, r]
            gradients.mass[i] += left_mass[i, r] * shapes[i, r]
    for r in range(m):
        gradients.rayleigh[0] += found.damping[r]
        gradients.rayleigh[1] += found.damping[r] * omega[r] ** 2
        gradients.ratios[r] += found.damping[r] * 2.0 * omega[r]


@jit
def zeros_like(parameters):
    """Gradients of the shapes of the parameters, zero."""
    mass, stiffness, rayleigh, ratios = parameters
    return ChainParameters(
        np.zeros(mass.shape), np.zeros(stiffness.shape), np.zeros(rayleigh.shape), np.zeros(ratios.shape)
    )


@jit
def response_gradient(parameters, excitation, wanted, cotangent):
    """Gradient of sum_jk W_jk y_jk, W the `cotangent` (s, u), by the parameters: arrays of their shapes."""
    gradients = zeros_like(parameters)
    add_gradient(parameters, excitation, wanted, cotangent, np.empty((0, 0)), gradients)
    return gradients


@jit
def misfit_gradient(parameters, excitation, wanted, observed, weights):
    """Gradient of sum_jq weights_jq statistics_jq, of the first (s, 1) or all (s, 4) of `chain_misfit`.

    Memory: a few blocks of 128 samples and modes, whatever the length of the record.
    """
    gradients = zeros_like(parameters)
    add_gradient(parameters, excitation, wanted, observed, weights, gradients)
    return gradients


@jit
def change_of(parameters, directions, wanted, system, omega, rows):
    """What directions of the parameters do to the modes, a `ModalChange`."""
    m, d_mass = wanted.n_modes, directions.mass.reshape(omega.size, 1)
    shapes = np.ascontiguousarray(rows[:m].T)
    d_mass_shapes, turned = d_mass * shapes, directions.stiffness.reshape(omega.size, 1) * drifts_of(shapes)
    d_stiffness_shapes = turned.copy()
    d_stiffness_shapes[:-1] -= turned[1:]
    load, at_sensors = np.dot(rows[:m], d_mass), np.zeros((wanted.sensors.size, m))
    if m < omega.size:
        outside = -outside_span(omega, rows, m, d_stiffness_shapes - d_mass_shapes * system.omega**2)
        load += np.dot(outside.T, parameters.mass.reshape(omega.size, 1))
        for j in range(wanted.sensors.size):
            at_sensors[j] = outside[wanted.sensors[j]]
    damping = np.empty(m)
    for r in range(m):
        damping[r] = modal_damping(omega[r], directions.rayleigh, directions.ratios[r])
    return ModalChange(
        np.dot(rows[:m], d_stiffness_shapes), np.dot(rows[:m], d_mass_shapes), load, at_sensors, damping
    )


@jit
def tangent(parameters, excitation, wanted, directions, observed, history):
    """As `march_change`, along directions of the parameters; NaN where these describe no structure."""
    directions = ChainParameters(*directions)
    check_sizes(parameters, wanted)
    check_sizes(directions, wanted)
    if parameters.mass.size != directions.mass.size:
        raise ValueError("the directions must have the shapes of the parameters")
    valid, system, omega, rows = modes_of(parameters, excitation.dt / excitation.substeps, wanted)
    if not valid:
        history[:] = np.nan
        return np.full(wanted.sensors.size, np.nan)
    law, feed = DampingLaw(parameters.rayleigh, parameters.ratios), relative_feed(wanted)
    change = change_of(parameters, directions, wanted, system, omega, rows)
    motion = ground_motion(excitation)
    return march_change(system, law, feed, motion, wanted.quantity, change, observed, history)


@jit
def response_tangent(parameters, excitation, wanted, directions):
    """Derivative (s, u) of the response along a direction of each parameter."""
    total = n_outputs(excitation.acceleration.size, excitation.substeps, excitation.stride)
    history = np.empty((wanted.sensors.size, total))
    tangent(parameters, excitation, wanted, directions, history, history)
    return history


@jit
def discrepancy_tangent(parameters, excitation, wanted, observed, directions):
    """Derivative (s,) of e_j, Eq. (3), along a direction of each parameter."""
    check_history(observed, excitation, wanted)
    sums = tangent(parameters, excitation, wanted, directions, observed, np.empty((0, 0)))
    return sums / observed.shape[1]
