"""Gradients and tangents of uncoupled modes: the recursion of `sensitivity`, for several inputs.

The response is y = sum_ir S phi_r Gamma_ri f_r[a_i], f the output of a mode under one input. All that a
gradient needs of the history are the sums over time of w_j f_r, w_j df_r/dlambda and w_j df_r/dD, w the
weights on y; the rest is algebra of the size of the kept modes, with the divided differences of `pairs`.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.linear.arguments import writable
from pymc_features.simulators.linear.projection import Cotangent
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION
from pymc_features.simulators.oscillators.close_modes import close_modes
from pymc_features.simulators.oscillators.derivatives import (
    march_change,
    oscillator_coefficients,
    sum_histories,
)
from pymc_features.simulators.oscillators.sensitivity import N_COEFFICIENTS


@jit
def prepare(omega, drag, rayleigh, ratios, seen, participation, step, quantity, duration):
    """Coefficients and outputs of the kernels above, and which pairs are close, each mode to itself, (m, m).

    Parameters
    ----------
    omega, drag, ratios : array (m,)
    rayleigh : array (2,)
    seen, participation : array (s, m), (m, d)
        S Phi, and Gamma.
    duration : float
        Of the record [s].
    """
    (m, n_inputs), n_sensors = participation.shape, seen.shape[0]
    coefficients = oscillator_coefficients(omega, drag, rayleigh, ratios, step, quantity)
    padded = coefficients.shape[0] // N_COEFFICIENTS * LANES
    outputs = np.zeros((n_inputs, padded, n_sensors))
    close, _ = close_modes(omega, rayleigh, ratios, duration, m)
    for r in range(m):
        close[r, r] = True
        for i in range(n_inputs):
            for j in range(n_sensors):
                outputs[i, r, j] = participation[r, i] * seen[j, r]
    return coefficients, outputs, close


@jit
def reduce_sums(omega, seen, participation, close, sums):
    """Derivatives of L by Phi' K Phi, Phi' M Phi (m, m), Phi' L (m, d); sum_i Gamma_ri w_j f_r[a_i] (s, m).

    `sums` (2, d, s, >= m) are those of w_j f_r and w_j df_r/dlambda.
    """
    (m, n_inputs), n_sensors = participation.shape, seen.shape[0]
    f, f_lambda = np.zeros((n_sensors, m)), np.zeros((n_sensors, m))
    by_load, slopes = np.zeros((m, n_inputs)), np.zeros((m, n_inputs))
    for i in range(n_inputs):
        for j in range(n_sensors):
            for r in range(m):
                f[j, r] += participation[r, i] * sums[0, i, j, r]
                f_lambda[j, r] += participation[r, i] * sums[1, i, j, r]
                by_load[r, i] += seen[j, r] * sums[0, i, j, r]
                slopes[r, i] += seen[j, r] * sums[1, i, j, r]
    products, crossed = np.dot(seen.T, f), np.dot(by_load, participation.T)
    derivatives = np.dot(seen.T, f_lambda) + np.dot(slopes, participation.T)
    by_stiffness, by_mass = np.empty((m, m)), np.empty((m, m))
    for r in range(m):
        for s in range(m):
            if close[r, s]:
                both = 0.5 * (derivatives[r, s] + derivatives[s, r])
            else:
                apart = (products[s, r] - crossed[s, r]) - (products[r, s] - crossed[r, s])
                both = apart / ((omega[r] - omega[s]) * (omega[r] + omega[s]))
            inertia = products[r, s] + crossed[r, s] + products[s, r] + crossed[s, r]
            mean = 0.5 * (omega[r] * omega[r] + omega[s] * omega[s])
            by_stiffness[r, s] = 0.5 * both
            by_mass[r, s] = -0.5 * (mean * both + 0.5 * inertia)
    return by_stiffness, by_mass, by_load, f


@jit
def pull_back_modes(modes, feed, inputs, substeps, stride, history, weights):
    """What `reduce_sums` returns, and derivatives by D (m,), of L = sum w y or sum_j c_j e_j.

    `modes` is what `prepare` takes; `feed`, `history` and `weights` are as in `sum_histories`.
    """
    omega, _, _, _, seen, participation, step, _, _ = modes
    coefficients, outputs, close = prepare(*modes)
    sums = sum_histories(coefficients, outputs, feed, inputs, substeps, stride, history, weights)
    by_drag = np.zeros(omega.size)
    for i in range(sums.shape[1]):
        for j in range(seen.shape[0]):
            for r in range(omega.size):
                by_drag[r] += step * seen[j, r] * participation[r, i] * sums[2, i, j, r]
    return reduce_sums(omega, seen, participation, close, sums[:2]), by_drag


def modes_of(a, system):
    """What `prepare` takes, and what stands before the inputs in the response, (s, d)."""
    duration, seen = a.shape[1] * a.stride * a.step, writable(a.sensors @ system.shapes)
    feed = np.zeros((seen.shape[0], a.acceleration.shape[0]))
    if a.quantity == ABSOLUTE_ACCELERATION:
        feed += a.sensors @ a.influence
    law = writable(a.rayleigh), writable(a.ratios[: system.omega.size])
    modes = system.omega, system.drag, *law, seen, writable(system.participation)
    return (*modes, a.step, a.quantity, duration), feed


def pull_back(a, system, history, weights):
    """Derivatives of L = sum w y, or of sum_j c_j e_j with `weights` c, see `Cotangent`."""
    modes, feed = modes_of(a, system)
    (by_stiffness, by_mass, by_load, f), by_drag = pull_back_modes(
        *(modes, feed, a.inputs, *a.grid),
        *(writable(history), writable(weights)),
    )
    omega, ratios = system.omega, np.zeros(a.ratios.size)
    ratios[: omega.size] = 2.0 * omega * by_drag
    return Cotangent(
        stiffness=by_stiffness,
        mass=by_mass,
        damping=None,
        load=by_load,
        shapes=a.sensors.T @ f + system.load @ by_load.T,
        rayleigh=np.array([by_drag.sum(), omega**2 @ by_drag]),
        ratios=ratios,
    )


def push_forward(a, system, motion, d_rayleigh, d_ratios, observed, history, sums):
    """Write the change of the response, or of its comparison with data, see `take_change`."""
    modes, feed = modes_of(a, system)
    coefficients, outputs, close = prepare(*modes)
    m, omega, seen, participation = system.omega.size, system.omega, modes[4], system.participation
    eigenvalues = omega**2
    change = motion.stiffness - 0.5 * (eigenvalues[:, None] + eigenvalues) * motion.mass
    gaps = (omega[:, None] - omega) * (omega[:, None] + omega)
    apart = change / np.where(close, np.inf, gaps)
    together = np.where(close, 0.5 * change, 0.0)
    drag = d_rayleigh[0] + d_rayleigh[1] * eigenvalues + 2.0 * d_ratios[:m] * omega
    moved = a.sensors @ motion.shapes
    load = motion.load + motion.shapes.T @ system.load
    seen_change = (
        seen @ (-apart - 0.5 * motion.mass) + moved,
        seen @ together,
        seen * (a.step * drag),
    )
    load_change = (apart - 0.5 * motion.mass) @ participation + load, together @ participation, None
    combination = np.zeros((3, *outputs.shape))
    for k in range(3):
        combination[k, :, :m] = participation.T[:, :, None] * seen_change[k].T
        if load_change[k] is not None:
            combination[k, :, :m] += load_change[k].T[:, :, None] * seen.T
    march_change(
        *(coefficients, combination, outputs, feed, a.inputs, *a.grid),
        *(observed, history, sums),
    )
