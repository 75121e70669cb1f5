"""Derivatives of response and discrepancy along a direction: the transpose of `gradient.py`.

The derivative of the response is one linear combination each of the modal outputs, of their derivatives by
the eigenvalue, and of those by the damping: three matrix products instead of the response's one.
"""

import numpy as np

from pymc_features.simulators.chain.gradient import sensor_shapes
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION, interpolate, n_outputs
from pymc_features.simulators.oscillators.close_modes import close_modes
from pymc_features.simulators.oscillators.recursion import BLOCK, check_sizes
from pymc_features.simulators.oscillators.sensitivity import advance_modes, sensitive_modes


@jit
def turned_directions(mode_shapes, d_mass, d_stiffness):
    """phi' dK phi, phi' dM phi (n, n), and phi' dM 1 (n,)."""
    n = d_mass.size
    drifts, scaled = np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        for r in range(n):
            drifts[i, r] = mode_shapes[r, i] - (mode_shapes[r, i - 1] if i > 0 else 0.0)
            scaled[i, r] = d_stiffness[i] * drifts[i, r]
    by_stiffness = np.dot(drifts.T, scaled)
    for r in range(n):
        for i in range(n):
            scaled[r, i] = mode_shapes[r, i] * d_mass[i]
    return by_stiffness, np.dot(scaled, mode_shapes.T), scaled.sum(axis=1)


@jit
def combine(shapes, omega, participation, turned, rayleigh, ratios, close, n_modes, step, combination):
    """Write how the derivative of the response is combined.

    Parameters
    ----------
    shapes : array (s, n)
        Mode shapes at the sensors.
    turned : tuple of arrays
        From `turned_directions`.
    rayleigh, ratios : array (2,), (n,)
        Directions of these parameters.
    combination : array (3, padded, s)
        Written: the factors of f, of df/dlambda and of df/dd.
    """
    d_stiffness, d_mass, d_load = turned
    combination[:] = 0.0
    for r in range(n_modes):
        eigenvalue = omega[r] * omega[r]
        change = d_stiffness[r, r] - eigenvalue * d_mass[r, r]
        damping = step * (rayleigh[0] + eigenvalue * rayleigh[1] + 2.0 * omega[r] * ratios[r])
        for j in range(shapes.shape[0]):
            shape = shapes[j, r]
            combination[0, r, j] += shape * (d_load[r] - participation[r] * d_mass[r, r])
            combination[1, r, j] += shape * participation[r] * change
            combination[2, r, j] += shape * participation[r] * damping
        for s in range(omega.size):
            if s == r or r < s < n_modes:
                continue
            kept = s < n_modes
            change = d_stiffness[r, s] - eigenvalue * d_mass[r, s]
            gap = (omega[r] - omega[s]) * (omega[r] + omega[s])
            for j in range(shapes.shape[0]):
                both = participation[r] * shapes[j, s] + participation[s] * shapes[j, r]
                if kept:
                    combination[0, s, j] -= both * d_mass[r, s]
                if kept and close[r, s]:
                    combination[1, r, j] += 0.5 * both * change
                    combination[1, s, j] += 0.5 * both * change
                else:
                    combination[0, r, j] += both * change / gap
                    if kept:
                        combination[0, s, j] -= both * change / gap


@jit
def march_tangent(coefficients, combination, outputs, acceleration, sampling, feed, observed, history, sums):
    """Write the derivative of the response into `history` or, if empty, of the discrepancy into `sums`."""
    substeps, stride, total = sampling
    padded, n_sensors = outputs.shape
    states = np.zeros((4 * (padded // LANES), LANES))
    ground = np.empty(BLOCK * stride + 1)
    f, f_lambda, f_d = np.empty((BLOCK, padded)), np.empty((BLOCK, padded)), np.empty((BLOCK, padded))
    lanes = (f.reshape(-1, LANES), f_lambda.reshape(-1, LANES), f_d.reshape(-1, LANES))
    part, change = np.empty((BLOCK, n_sensors)), np.empty((BLOCK, n_sensors))
    for first in range(0, total, BLOCK):
        count = min(BLOCK, total - first)
        interpolate(acceleration, substeps, first * stride, ground)
        advance_modes(coefficients, states, ground, stride, *lanes)
        np.dot(f, combination[0], change)
        np.dot(f_lambda, combination[1], part)
        change += part
        np.dot(f_d, combination[2], part)
        change += part
        if history.size:
            for j in range(n_sensors):
                for b in range(count):
                    history[j, first + b] = change[b, j]
        else:
            np.dot(f, outputs, part)
            for j in range(n_sensors):
                for b in range(count):
                    misfit = part[b, j] + feed * ground[b * stride] - observed[j, first + b]
                    sums[j] += 2.0 / total * misfit * change[b, j]


@jit
def tangent(
    parameters,
    directions,
    acceleration,
    dt,
    substeps,
    stride,
    sensors,
    n_modes,
    quantity,
    observed,
    history,
    sums,
):
    """As `march_tangent`, from the parameters and their directions; NaN where they describe no structure."""
    mass, stiffness, rayleigh, ratios = parameters
    d_mass, d_stiffness, d_rayleigh, d_ratios = directions
    check_sizes(mass, stiffness, rayleigh, ratios, sensors, n_modes)
    check_sizes(d_mass, d_stiffness, d_rayleigh, d_ratios, sensors, n_modes)
    if mass.size != d_mass.size:
        raise ValueError("the directions must have the shapes of the parameters")
    total = n_outputs(acceleration.size, substeps, stride)
    if not history.size and (observed.shape[0] != sensors.size or observed.shape[1] != total):
        raise ValueError("`observed` must have the shape (sensor, time) of the response")
    step = dt / substeps
    valid, omega, participation, mode_shapes, coefficients = sensitive_modes(
        mass, stiffness, rayleigh, ratios, step, n_modes, quantity
    )
    if not valid:
        history[:], sums[:] = np.nan, np.nan
        return
    padded = LANES * ((n_modes + LANES - 1) // LANES)
    shapes, outputs = sensor_shapes(mode_shapes, participation, sensors, padded)
    outputs[n_modes:] = 0.0
    close, _ = close_modes(omega, rayleigh, ratios, total * stride * step, n_modes)
    combination = np.empty((3, padded, sensors.size))
    turned = turned_directions(mode_shapes, d_mass, d_stiffness)
    combine(shapes, omega, participation, turned, d_rayleigh, d_ratios, close, n_modes, step, combination)
    feed = 1.0 if quantity == ABSOLUTE_ACCELERATION else 0.0
    march_tangent(
        *(coefficients, combination, outputs, acceleration, (substeps, stride, total)),
        *(feed, observed, history, sums),
    )


@jit
def response_tangent(parameters, excitation, wanted, directions):
    """Derivative (s, u) of the response along a direction of mass, stiffness, rayleigh and ratios.

    Parameters as in `recursion.chain_response`, and the direction. NaN where they describe no structure.
    """
    mass, stiffness, rayleigh, ratios = parameters
    acceleration, dt, substeps, stride = excitation
    sensors, n_modes, quantity = wanted
    history = np.empty((sensors.size, n_outputs(acceleration.size, substeps, stride)))
    tangent(
        *(parameters, directions),
        *(acceleration, dt, substeps, stride, sensors, n_modes, quantity),
        *(np.empty((0, 0)), history, np.empty(0)),
    )
    return history


@jit
def discrepancy_tangent(parameters, excitation, wanted, observed, directions):
    """Derivative (s,) of e_j, Eq. (3), along a direction of mass, stiffness, rayleigh and ratios.

    Parameters as in `discrepancy.chain_discrepancy`, and the direction. NaN where they describe no structure.
    """
    mass, stiffness, rayleigh, ratios = parameters
    acceleration, dt, substeps, stride = excitation
    sensors, n_modes, quantity = wanted
    sums = np.zeros(sensors.size)
    tangent(
        *(parameters, directions),
        *(acceleration, dt, substeps, stride, sensors, n_modes, quantity),
        *(observed, np.empty((0, 0)), sums),
    )
    return sums
