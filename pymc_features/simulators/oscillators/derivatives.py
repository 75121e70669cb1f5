"""Histories of uncoupled modes under several inputs with their derivatives, and sums over them.

The recursion of `sensitivity`, a mode in each lane; the responses to the inputs add up.
"""

import numpy as np

from pymc_features.simulators.chain.gradient import copy_block, weigh_misfit
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.oscillators.arguments import interpolate
from pymc_features.simulators.oscillators.blocks import take_change
from pymc_features.simulators.oscillators.march import SMALLEST_FREQUENCY
from pymc_features.simulators.oscillators.recursion import BLOCK, N_ROWS
from pymc_features.simulators.oscillators.sensitivity import (
    N_COEFFICIENTS,
    N_OUTPUT,
    N_STEP,
    advance_modes,
    fill_mode,
)


@jit
def oscillator_coefficients(omega, drag, rayleigh, ratios, step, quantity):
    """Coefficients (27 groups, LANES) of `sensitivity.advance_modes`; zero in lanes without a mode."""
    groups = (omega.size + LANES - 1) // LANES
    coefficients = np.zeros((N_COEFFICIENTS * groups, LANES))
    work = np.empty((N_ROWS, 1)), np.empty(N_STEP), np.empty(N_OUTPUT)
    for r in range(omega.size):
        frequency = max(omega[r], SMALLEST_FREQUENCY)
        # of D = alpha + beta lambda + 2 ratio omega; nothing pushes a rigid body's lambda
        slope = rayleigh[1]
        if omega[r] > 0.0:
            slope += ratios[r] / omega[r]
        zeta = drag[r] / (2.0 * frequency)
        fill_mode(frequency * step, zeta, slope, step, quantity, r, work, coefficients)
    return coefficients


@jit
def advance_inputs(coefficients, states, inputs, substeps, stride, first, ground, values):
    """Write `BLOCK` samples of f, df/dlambda and df/d(D h) of all modes under each input.

    Parameters
    ----------
    states : array (d, 4 groups, LANES)
        Overwritten.
    ground, values : array (d, BLOCK stride + 1), (3, d, BLOCK, padded)
        Written: the inputs at the steps of the recursion, and the histories.
    """
    for i in range(inputs.shape[0]):
        interpolate(inputs[i], substeps, first * stride, ground[i])
        advance_modes(
            *(coefficients, states[i], ground[i], stride, values[0, i].reshape(-1, LANES)),
            *(values[1, i].reshape(-1, LANES), values[2, i].reshape(-1, LANES)),
        )


@jit
def add_outputs(values, outputs, feed, ground, stride, part, response):
    """Write one block of the response (BLOCK, s), from f (d, BLOCK, padded)."""
    response[:] = 0.0
    for i in range(outputs.shape[0]):
        np.dot(values[i], outputs[i], part)
        for b in range(BLOCK):
            for j in range(part.shape[1]):
                response[b, j] += part[b, j] + feed[j, i] * ground[i, b * stride]


@jit
def sum_histories(coefficients, outputs, feed, inputs, substeps, stride, history, weights):
    """Sums over time of w_j f_r, w_j df_r/dlambda and w_j df_r/d(D h) of each input, (3, d, s, padded).

    Parameters
    ----------
    coefficients : array (27 groups, LANES)
        From `oscillator_coefficients`.
    outputs : array (d, padded, s)
        S phi_r Gamma_ri, zero beyond the modes.
    feed : array (s, d)
        What stands before the inputs in the response.
    history : array (s, u)
        The weights w or, if there are `weights`, the data.
    weights : array (s,) or (0,)
        Cotangent of the discrepancy.
    """
    n_inputs, padded, n_sensors = outputs.shape
    total = history.shape[1]
    states = np.zeros((n_inputs, 4 * (padded // LANES), LANES))
    ground, values = np.empty((n_inputs, BLOCK * stride + 1)), np.empty((3, n_inputs, BLOCK, padded))
    weighted, part = np.empty((BLOCK, n_sensors)), np.empty((BLOCK, n_sensors))
    product, sums = np.empty((n_sensors, padded)), np.zeros((3, n_inputs, n_sensors, padded))
    for first in range(0, total, BLOCK):
        advance_inputs(coefficients, states, inputs, substeps, stride, first, ground, values)
        if weights.size:
            add_outputs(values[0], outputs, feed, ground, stride, part, weighted)
            weigh_misfit(weighted, ground[0], stride, 0.0, history, first, weights, total, weighted)
        else:
            copy_block(history, first, weighted)
        for k in range(3):
            for i in range(n_inputs):
                np.dot(weighted.T, values[k, i], product)
                sums[k, i] += product
    return sums


@jit
def march_change(coefficients, combination, outputs, feed, inputs, substeps, stride, observed, history, sums):
    """Carry the change of the response through the record; see `take_change` for what becomes of it.

    `combination` (3, d, padded, s) has the factors of f, df/dlambda and df/d(D h), the rest is as above.
    """
    n_inputs, padded, n_sensors = outputs.shape
    total = max(history.shape[1], observed.shape[1])
    states = np.zeros((n_inputs, 4 * (padded // LANES), LANES))
    ground, values = np.empty((n_inputs, BLOCK * stride + 1)), np.empty((3, n_inputs, BLOCK, padded))
    part, response = np.empty((BLOCK, n_sensors)), np.empty((BLOCK, n_sensors))
    change = np.empty((BLOCK, n_sensors))
    for first in range(0, total, BLOCK):
        advance_inputs(coefficients, states, inputs, substeps, stride, first, ground, values)
        change[:] = 0.0
        for k in range(3):
            for i in range(n_inputs):
                np.dot(values[k, i], combination[k, i], part)
                change += part
        if not history.size:
            add_outputs(values[0], outputs, feed, ground, stride, part, response)
        take_change(response, change, first, min(BLOCK, total - first), observed, history, sums)
