"""Gradient of the response of uncoupled modes, and of its misfit, exact and in one sweep.

The response is y = sum_ir S phi_r Gamma_ri f_r[a_i], f_r[a_i] the output of a mode under one input. All that
the gradient of L needs of the history, with the weights w = dL/dy, are the sums over time

    (S, f)  sum_k w_j f_r[a_i],    (S, f')  sum_k w_j df_r[a_i]/dlambda,    sum_k u_r df_r[a_i]/d(D h),

with u = Phi' S' w, taken while the recursion runs forward: no history is kept, and no cost grows with the
number of parameters. The rest is algebra of the size of the kept modes, with the divided differences of
`close_modes`.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    interpolate,
    write_own,
)
from pymc_features.simulators.oscillators.close_modes import close_modes
from pymc_features.simulators.oscillators.fast_modes import (
    N_ORDERS,
    STIFFEST,
    follow,
    highest_step,
    write_following,
)
from pymc_features.simulators.oscillators.misfit import copy_block, weigh_misfit
from pymc_features.simulators.oscillators.recursion import BLOCK, add_feed
from pymc_features.simulators.oscillators.sensitivity import (
    N_COEFFICIENTS,
    advance_modes,
    sensitivity_coefficients,
)


class ModalGradient(NamedTuple):
    """Derivatives of a number L with respect to what the kernels over time know of a structure.

    Attributes
    ----------
    stiffness, mass : array (m, m)
        By Phi' K Phi and Phi' M Phi, at fixed Phi.
    load : array (m, d)
        By Phi' L, the load whose projection is Gamma.
    shapes : array (s, m)
        By S Phi, outside of the span of Phi.
    damping : array (m,)
        By D.
    """

    stiffness: np.ndarray
    mass: np.ndarray
    load: np.ndarray
    shapes: np.ndarray
    damping: np.ndarray


class Histories(NamedTuple):
    """The modes of a structure on their way through a record, one block of time after another.

    Attributes
    ----------
    coefficients : array (27 groups, LANES)
        Of `advance_modes`.
    states : array (d, 4 groups, LANES)
    ground : array (d, BLOCK stride + 1)
        The inputs at the steps of the recursion.
    values : array (3, d, BLOCK + 1, padded)
        f, df/dlambda and df/d(D h); row 0 is that of the sample before the block.
    lanes : array (3, d, (BLOCK + 1) groups, LANES)
        The same values, as `advance_modes` writes them.
    outputs : array (d, s, padded)
        S phi_r Gamma_ri, zero beyond the modes.
    own : array (d, BLOCK)
        The inputs' own values at the samples.
    is_relative : bool
        Whether outputs have the inputs' own values in them, with -1.
    fast : integer array (f,)
        Modes that follow their input.
    factors : array (f, 3, 5)
        Of `fast_modes.follow`.
    """

    coefficients: np.ndarray
    states: np.ndarray
    ground: np.ndarray
    values: np.ndarray
    lanes: np.ndarray
    outputs: np.ndarray
    own: np.ndarray
    is_relative: bool
    fast: np.ndarray
    factors: np.ndarray


@jit
def new_histories(system, law, excitation, quantity):
    """The modes at rest before a record."""
    step, stride = excitation.dt / excitation.substeps, excitation.stride
    (n_modes, n_inputs), n_sensors = system.participation.shape, system.shapes.shape[0]
    highest = highest_step(excitation)
    fast = np.flatnonzero((system.omega * step > highest) | (system.damping * step >= STIFFEST))
    coefficients, factors = (
        sensitivity_coefficients(system, law, step, quantity),
        np.empty((fast.size, 3, N_ORDERS)),
    )
    for n in range(fast.size):
        omega, damping = system.omega[fast[n]], system.damping[fast[n]]
        slope = law.rayleigh[1] + law.ratios[fast[n]] / omega
        write_following(omega, damping, slope, quantity, factors[n])
        factors[n, 2] /= step
    groups = coefficients.shape[0] // N_COEFFICIENTS
    outputs = np.zeros((n_inputs, n_sensors, groups * LANES))
    for i in range(n_inputs):
        for r in range(n_modes):
            for j in range(n_sensors):
                outputs[i, j, r] = system.participation[r, i] * system.shapes[j, r]
    states, ground = np.zeros((n_inputs, 4 * groups, LANES)), np.empty((n_inputs, BLOCK * stride + 1))
    values = np.empty((3, n_inputs, BLOCK + 1, groups * LANES))
    values[:, :, BLOCK] = 0.0
    lanes = values.reshape(3, n_inputs, (BLOCK + 1) * groups, LANES)
    own, is_relative = np.empty((n_inputs, BLOCK)), quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION)
    return Histories(coefficients, states, ground, values, lanes, outputs, own, is_relative, fast, factors)


@jit
def advance_histories(modes, excitation, first):
    """Write a block of values of all modes under each input, from sample `first` on."""
    inputs, _, substeps, stride, direct = excitation
    for i in range(inputs.shape[0]):
        for k in range(3):
            own = modes.values[k, i]
            for r in range(own.shape[1]):
                own[0, r] = own[BLOCK, r]
        ground, states = modes.ground[i], modes.states[i]
        f, f_lambda, f_damping = modes.lanes[0, i], modes.lanes[1, i], modes.lanes[2, i]
        interpolate(inputs[i], substeps, first * stride, ground)
        advance_modes(modes.coefficients, states, ground, stride, f, f_lambda, f_damping)
    write_own(excitation, modes.ground, first, BLOCK, modes.own)
    if direct.size and modes.is_relative:
        for i in range(inputs.shape[0]):
            own = modes.values[0, i]
            for b in range(BLOCK):
                excess = modes.own[i, b] - modes.ground[i, b * stride]
                for r in range(own.shape[1]):
                    own[b + 1, r] -= excess
    if modes.fast.size:
        follow(modes.fast, modes.factors, excitation, modes.ground, first, modes.values)


@jit
def write_response(modes, feed, part, response):
    """Write one block of the response (s, BLOCK); `part` (s, BLOCK) is overwritten."""
    for i in range(modes.outputs.shape[0]):
        target = response if i == 0 else part
        np.dot(modes.outputs[i], modes.values[0, i, 1:].T, target)
        if i > 0:
            response += part
    add_feed(feed, modes.own, BLOCK, response)


@jit
def sum_histories(modes, system, feed, excitation, history, weights, some_are_close):
    """Sums over time, see above.

    Parameters
    ----------
    modes : Histories
    feed : array (s, d)
        What stands before the inputs in the response, beside an f that has -a in accelerations.
    history : array (s, u)
        The weights w or, if there are `weights`, the data.
    weights : array (s, q) or (0, 0)
        Derivatives of L by the statistics of the misfit, see `misfit`.
    some_are_close : bool
        Whether (S, f') is wanted.

    Returns
    -------
    outputs, slopes : array (d, s, padded)
        (S, f) and (S, f').
    grad_lambda, grad_damping : array (d, m)
        sum_k u_r df_r[a_i]/dlambda and sum_k u_r df_r[a_i]/d(D h).
    """
    n_inputs, n_sensors, padded = modes.outputs.shape
    total, (_, n_modes) = history.shape[1], system.shapes.shape
    response, part = np.empty((n_sensors, BLOCK)), np.empty((n_sensors, BLOCK))
    misfits, weighted = np.zeros((n_sensors, BLOCK + 1)), np.empty((n_sensors, BLOCK + 1))
    product, in_modes = np.empty((n_sensors, padded)), np.empty((BLOCK + 1, n_modes))
    outputs, slopes = np.zeros((n_inputs, n_sensors, padded)), np.zeros((n_inputs, n_sensors, padded))
    grad_lambda, grad_damping = np.zeros((n_inputs, n_modes)), np.zeros((n_inputs, n_modes))
    for first in range(0, total, BLOCK):
        advance_histories(modes, excitation, first)
        if weights.size:
            write_response(modes, feed, part, response)
            weigh_misfit(response, history, first, weights, misfits, weighted)
        else:
            copy_block(history, first, weighted)
        np.dot(weighted.T, system.shapes, in_modes)
        for i in range(n_inputs):
            f_lambda, f_damping = modes.values[1, i], modes.values[2, i]
            np.dot(weighted, modes.values[0, i], product)
            outputs[i] += product
            if some_are_close:
                np.dot(weighted, f_lambda, product)
                slopes[i] += product
            own_grad_lambda, own_grad_damping = grad_lambda[i], grad_damping[i]
            for b in range(BLOCK + 1):
                for r in range(n_modes):
                    own_grad_lambda[r] += in_modes[b, r] * f_lambda[b, r]
                    own_grad_damping[r] += in_modes[b, r] * f_damping[b, r]
    return outputs, slopes, grad_lambda, grad_damping


@jit
def reduce_sums(system, close, some_are_close, outputs, slopes, grad_lambda):
    """Derivatives of L by Phi' K Phi, Phi' M Phi (m, m), Phi' L (m, d) and S Phi (s, m), from the sums.

    With P = Phi' S' F and Q = (dL/d(Phi' L)) Gamma', where F = sum_i (S, f)_i Gamma_i, the pair r, s has the
    divided difference [(P - Q)_sr - (P - Q)_rs] / (lambda_r - lambda_s), or its limit where it is close.
    """
    omega, participation = system.omega, system.participation
    (n_sensors, m), n_inputs = system.shapes.shape, participation.shape[1]
    f, f_lambda, load = np.zeros((n_sensors, m)), np.zeros((n_sensors, m)), np.zeros((m, n_inputs))
    for i in range(n_inputs):
        for j in range(n_sensors):
            for r in range(m):
                f[j, r] += participation[r, i] * outputs[i, j, r]
                f_lambda[j, r] += participation[r, i] * slopes[i, j, r]
                load[r, i] += system.shapes[j, r] * outputs[i, j, r]
    p, q = np.dot(system.shapes.T, f), np.dot(load, participation.T)
    limits = np.dot(grad_lambda.T, participation.T)
    if some_are_close:
        limits += np.dot(system.shapes.T, f_lambda)
    else:
        for r in range(m):
            limits[r, r] *= 2.0  # both terms are equal for a mode by itself
    stiffness, mass = np.empty((m, m)), np.empty((m, m))
    for r in range(m):
        for s in range(m):
            if close[r, s]:
                difference = 0.5 * (limits[r, s] + limits[s, r])
            else:
                apart = (p[s, r] - q[s, r]) - (p[r, s] - q[r, s])
                difference = apart / ((omega[r] - omega[s]) * (omega[r] + omega[s]))
            mean = 0.5 * (omega[r] * omega[r] + omega[s] * omega[s])
            norm = p[r, s] + q[r, s] + p[s, r] + q[s, r]  # by the scale of the modes, phi' M phi = 1
            stiffness[r, s] = 0.5 * difference
            mass[r, s] = -0.5 * (mean * difference + 0.5 * norm)
    return stiffness, mass, load, f


@jit
def modal_gradient(system, law, feed, excitation, quantity, history, weights):
    """Gradient of L = sum w y, w the `history`, or of a function of the misfit, see `sum_histories`.

    Parameters
    ----------
    system : ModalSystem
    law : DampingLaw
    feed, history, weights
        As in `sum_histories`.

    Returns
    -------
    ModalGradient
    """
    step = excitation.dt / excitation.substeps
    duration = history.shape[1] * excitation.stride * step
    close, some_are_close = close_modes(system.omega, law, duration)
    modes = new_histories(system, law, excitation, quantity)
    outputs, slopes, grad_lambda, grad_damping = sum_histories(
        modes, system, feed, excitation, history, weights, some_are_close
    )
    damping = np.zeros(system.omega.size)
    for r in range(damping.size):
        for i in range(grad_damping.shape[0]):
            damping[r] += step * system.participation[r, i] * grad_damping[i, r]
    stiffness, mass, load, shapes = reduce_sums(system, close, some_are_close, outputs, slopes, grad_lambda)
    return ModalGradient(stiffness, mass, load, shapes, damping)
