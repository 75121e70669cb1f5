"""Gradients of response and discrepancy with respect to masses, springs and damping, exact and in one sweep.

With weights W on the response, L = sum_jk W_jk y_jk, all that L's gradient needs from the history is the
matrix of sum_k u_s(k) f_r(k), with u = phi' W the modal weights and f the modal outputs, and the sums of u_r
df_r. They are summed up while the recursion runs forward: three matrix products instead of the response's
one, no history kept, and no cost that grows with the number of parameters.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION, interpolate, n_outputs
from pymc_features.simulators.oscillators.close_modes import close_modes, pair_weights
from pymc_features.simulators.oscillators.recursion import BLOCK, check_sizes
from pymc_features.simulators.oscillators.sensitivity import advance_modes, sensitive_modes


@jit
def sensor_shapes(mode_shapes, participation, sensors, padded):
    """Return phi (s, n) at the sensors, and (padded, s) phi_r Gamma_r of the kept modes, zero beyond."""
    n = participation.size
    shapes, outputs = np.empty((sensors.size, n)), np.zeros((padded, sensors.size))
    for j in range(sensors.size):
        for r in range(n):
            shapes[j, r] = mode_shapes[r, sensors[j]]
            if r < padded:
                outputs[r, j] = shapes[j, r] * participation[r]
    return shapes, outputs


@jit
def weigh_misfit(outputs, ground, stride, feed, data, first, weights, total, weighted):
    """Turn outputs (BLOCK, s) into the cotangent of the response, 2 c_j / N_D (g - y), in place."""
    count = min(BLOCK, total - first)
    for j in range(weights.size):
        factor = 2.0 * weights[j] / total
        for b in range(count):
            weighted[b, j] = factor * (outputs[b, j] + feed * ground[b * stride] - data[j, first + b])
    weighted[count:] = 0.0


@jit
def copy_block(history, first, block):
    """Copy samples from `first` on of a history (s, u) into `block` (BLOCK, s), zero behind its end."""
    count = min(BLOCK, history.shape[1] - first)
    for j in range(history.shape[0]):
        for b in range(count):
            block[b, j] = history[j, first + b]
    block[count:] = 0.0


@jit
def sum_up(
    coefficients, shapes, outputs, n_modes, some_are_close, acceleration, sampling, feed, history, weights
):
    """Sums over the history that the gradient is made of.

    Parameters
    ----------
    coefficients, shapes, outputs
        From `sensitive_modes` and `sensor_shapes`.
    sampling : tuple of int
        Substeps, stride, number of output samples.
    feed : float
        What stands before the ground acceleration in the response.
    history : array (s, u)
        The cotangent of the response or, if there are `weights`, the data.
    weights : array (s,) or (0,)
        Cotangent of the discrepancy.

    Returns
    -------
    products, slopes : array (n, n_modes)
        sum u_s f_r, and sum u_s df_r/dlambda: of that only the diagonal, unless some modes are close.
    by_damping : array (n_modes,)
        sum u_r df_r/dd.
    """
    substeps, stride, total = sampling
    n_sensors, n = shapes.shape
    padded = outputs.shape[0]
    states = np.zeros((4 * (padded // LANES), LANES))
    ground = np.empty(BLOCK * stride + 1)
    f, f_lambda, f_d = np.empty((BLOCK, padded)), np.empty((BLOCK, padded)), np.empty((BLOCK, padded))
    lanes = (f.reshape(-1, LANES), f_lambda.reshape(-1, LANES), f_d.reshape(-1, LANES))
    weighted, modal = np.empty((BLOCK, n_sensors)), np.empty((BLOCK, n))
    product = np.empty((n, padded))
    products, slopes, by_damping = np.zeros((n, padded)), np.zeros((n, padded)), np.zeros(padded)
    diagonal = np.zeros(padded)
    for first in range(0, total, BLOCK):
        interpolate(acceleration, substeps, first * stride, ground)
        advance_modes(coefficients, states, ground, stride, *lanes)
        if weights.size:
            np.dot(f, outputs, weighted)
            weigh_misfit(weighted, ground, stride, feed, history, first, weights, total, weighted)
        else:
            copy_block(history, first, weighted)
        np.dot(weighted, shapes, modal)
        np.dot(modal.T, f, product)
        products += product
        if some_are_close:
            np.dot(modal.T, f_lambda, product)
            slopes += product
        for b in range(BLOCK):
            for r in range(n_modes):
                diagonal[r] += modal[b, r] * f_lambda[b, r]
                by_damping[r] += modal[b, r] * f_d[b, r]
    for r in range(n_modes):
        slopes[r, r] = diagonal[r]
    return products, slopes, by_damping


@jit
def to_parameters(
    mode_shapes, omega, participation, products, by_damping, by_stiffness, by_mass, step, gradients
):
    """Add the gradient with respect to masses, springs, alpha and beta, and damping ratios to `gradients`."""
    d_mass, d_stiffness, d_rayleigh, d_ratios = gradients
    n = omega.size
    for r in range(by_damping.size):
        force = participation[r] * step * by_damping[r]
        d_rayleigh[0] += force
        d_rayleigh[1] += force * omega[r] * omega[r]
        d_ratios[r] += 2.0 * omega[r] * force
    drifts = np.empty((n, n))
    for i in range(n):
        for r in range(n):
            drifts[i, r] = mode_shapes[r, i] - (mode_shapes[r, i - 1] if i > 0 else 0.0)
    turned_drifts, turned_shapes = np.dot(drifts, by_stiffness), np.dot(mode_shapes.T, by_mass)
    for i in range(n):
        for r in range(n):
            d_stiffness[i] += turned_drifts[i, r] * drifts[i, r]
            d_mass[i] += turned_shapes[i, r] * mode_shapes[r, i]
        for r in range(by_damping.size):
            d_mass[i] += products[r, r] * mode_shapes[r, i]


@jit
def add_gradient(
    parameters,
    acceleration,
    dt,
    substeps,
    stride,
    sensors,
    n_modes,
    quantity,
    history,
    weights,
    gradients,
):
    """Add the gradient for one set of parameters to `gradients`; NaN where they describe no structure.

    Parameters
    ----------
    parameters, gradients : tuple of arrays
        mass, stiffness, rayleigh, ratios, and what is added to.
    history, weights
        As in `sum_up`.
    """
    mass, stiffness, rayleigh, ratios = parameters
    check_sizes(mass, stiffness, rayleigh, ratios, sensors, n_modes)
    total = n_outputs(acceleration.size, substeps, stride)
    if history.shape[0] != sensors.size or history.shape[1] != total:
        raise ValueError("`observed` or the cotangent must have the shape (sensor, time) of the response")
    step = dt / substeps
    valid, omega, participation, mode_shapes, coefficients = sensitive_modes(
        mass, stiffness, rayleigh, ratios, step, n_modes, quantity
    )
    if not valid:
        for gradient in gradients:
            gradient[:] = np.nan
        return
    padded = LANES * ((n_modes + LANES - 1) // LANES)
    shapes, outputs = sensor_shapes(mode_shapes, participation, sensors, padded)
    outputs[n_modes:] = 0.0
    close, some_are_close = close_modes(omega, rayleigh, ratios, total * stride * step, n_modes)
    feed = 1.0 if quantity == ABSOLUTE_ACCELERATION else 0.0
    products, slopes, by_damping = sum_up(
        *(coefficients, shapes, outputs, n_modes, some_are_close, acceleration),
        *((substeps, stride, total), feed, history, weights),
    )
    by_stiffness, by_mass = pair_weights(omega, participation, products, slopes, close, n_modes)
    to_parameters(
        *(mode_shapes, omega, participation, products, by_damping[:n_modes]),
        *(by_stiffness, by_mass, step, gradients),
    )


@jit
def response_gradient(parameters, excitation, wanted, cotangent):
    """Gradient of sum_jk W_jk y_jk, W the `cotangent` (s, u), with respect to the parameters.

    Parameters as in `recursion.chain_response`. Returns arrays (n,), (n,), (2,), (n,) for mass, stiffness,
    rayleigh and ratios; NaN where the parameters describe no structure.
    """
    mass, stiffness, rayleigh, ratios = parameters
    acceleration, dt, substeps, stride = excitation
    sensors, n_modes, quantity = wanted
    gradients = (np.zeros(mass.size), np.zeros(mass.size), np.zeros(2), np.zeros(mass.size))
    add_gradient(
        *((mass, stiffness, rayleigh, ratios), acceleration, dt, substeps, stride),
        *(sensors, n_modes, quantity, cotangent, np.zeros(0), gradients),
    )
    return gradients


@jit
def discrepancy_gradient(parameters, excitation, wanted, observed, weights):
    """Gradient of sum_j c_j e_j, c the `weights` (s,), e of Eq. (3), with respect to the parameters.

    Parameters as in `discrepancy.chain_discrepancy`. Returns as `response_gradient`. Memory: a few blocks of
    128 samples and modes, whatever the length of the record.
    """
    mass, stiffness, rayleigh, ratios = parameters
    acceleration, dt, substeps, stride = excitation
    sensors, n_modes, quantity = wanted
    gradients = (np.zeros(mass.size), np.zeros(mass.size), np.zeros(2), np.zeros(mass.size))
    add_gradient(
        *((mass, stiffness, rayleigh, ratios), acceleration, dt, substeps, stride),
        *(sensors, n_modes, quantity, observed, weights, gradients),
    )
    return gradients


@jit
def population_gradient(parameters, excitation, wanted, observed, weights):
    """Gradient of sum_pj c_pj e_pj of a population, c the `weights` (p, s), by its parameters.

    Parameters as in `population.population_discrepancy`. Returns arrays of the shapes of mass, stiffness,
    rayleigh and ratios; what all particles share gets the sum.
    """
    mass, stiffness, rayleigh, ratios = parameters
    acceleration, dt, substeps, stride = excitation
    sensors, n_modes, quantity = wanted
    gradients = (
        *(np.zeros(mass.shape), np.zeros(stiffness.shape)),
        *(np.zeros(rayleigh.shape), np.zeros(ratios.shape)),
    )
    for p in range(weights.shape[0]):
        own = (
            *(mass[p % mass.shape[0]], stiffness[p % stiffness.shape[0]]),
            *(rayleigh[p % rayleigh.shape[0]], ratios[p % ratios.shape[0]]),
        )
        own_gradients = (
            *(gradients[0][p % mass.shape[0]], gradients[1][p % stiffness.shape[0]]),
            *(gradients[2][p % rayleigh.shape[0]], gradients[3][p % ratios.shape[0]]),
        )
        add_gradient(
            *(own, acceleration, dt, substeps, stride),
            *(sensors, n_modes, quantity, observed, weights[p], own_gradients),
        )
    return gradients
