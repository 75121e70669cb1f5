"""Change of the response of a chain, and of its misfit, along a direction of masses, springs and damping.

Between the chain's parameters and its modes: K = sum_i k_i d_i d_i' with the drift d_i' x = x_i - x_{i-1} of
spring i, M = diag(m), load M 1. What the modes do over time is the matter of `oscillators.systems`.
"""

import numpy as np

from pymc_features.simulators.chain.parameters import ChainParameters
from pymc_features.simulators.chain.response import check_history, check_sizes, modes_of
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.eigen.outside import outside_span
from pymc_features.simulators.oscillators.arguments import n_outputs
from pymc_features.simulators.oscillators.evaluation import in_rows
from pymc_features.simulators.oscillators.modal_system import DampingLaw
from pymc_features.simulators.oscillators.recursion import modal_damping
from pymc_features.simulators.oscillators.systems import Direct, ModalChange, march_change


@jit
def drifts_of(shapes):
    """Drifts (n, k) of the springs in the columns of displacements (n, k)."""
    drifts = shapes.copy()
    drifts[1:] -= shapes[:-1]
    return drifts


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
    change = change_of(parameters, directions, wanted, system, omega, rows)
    law, s = DampingLaw(parameters.rayleigh, parameters.ratios), wanted.sensors.size
    direct = Direct(np.ones((s, 1)), np.zeros((s, 1)), wanted.n_modes == omega.size)
    given = in_rows(excitation), wanted.quantity, change, observed, history
    return march_change(system, law, direct, *given)


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
