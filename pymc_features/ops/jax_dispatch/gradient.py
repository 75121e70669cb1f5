"""The gradients of `simulators.gradient` in JAX, as custom derivatives of response and misfit."""

import jax
import jax.numpy as jnp
import numpy as np

from pymc_features.ops.jax_dispatch.history import (
    Sampling,
    discrepancy,
    march,
    misfit_statistics,
    response,
    sensor_output,
)
from pymc_features.ops.jax_dispatch.modes import Modes


def gradient(op, static, parameters, record, dt, sensors, history, weights):
    """Gradients of sum W y, W the history (s, u) or, if there are weights (s,), of their sum with e."""
    substeps, stride, n_modes = static
    modes = Modes(op, parameters, dt / substeps, n_modes, record[1])
    sampling = Sampling(record, dt, substeps, stride)
    shapes, output = modes.shapes[sensors], sensor_output(op, modes, sensors)
    n = shapes.shape[1]

    def visit(sums, states, at, there, data):
        products, slopes, grad_damping = sums
        weighted = data
        if weights is not None:
            off = jnp.where(jnp.isnan(data), 0.0, output(states, at) - data)
            weighted = 2.0 / sampling.total * weights * there * off
        modal = weighted @ shapes
        f_lambda, f_damping = modes.slopes(*states, at)
        return (
            products + modal.T @ modes.outputs(*states[:2], at),
            slopes + modal.T @ f_lambda,
            grad_damping + (modal[:, :n_modes] * f_damping).sum(axis=0),
        ), None

    zeros = (jnp.zeros((n, n_modes)), jnp.zeros((n, n_modes)), jnp.zeros(n_modes))
    sums, _ = march(modes, sampling, visit, zeros, history.T, derivatives=True)
    gradients = to_parameters(modes, *sums, modes.close(sampling.duration))
    return tuple(jnp.where(modes.valid, g, jnp.nan) for g in gradients)


def to_parameters(modes, products, slopes, grad_damping, close):
    """From the sums over the history to mass, stiffness, rayleigh and ratios; see `simulators.gradient`."""
    n, m = products.shape
    lam, gamma = modes.eigenvalues, modes.participation
    diagonal = jnp.eye(n, m, dtype=bool)
    close = jnp.zeros((n, m), dtype=bool).at[:m].set(close)
    kept = (jnp.arange(n) < m)[:, None]
    own_products = jnp.zeros(n).at[:m].set(jnp.diag(products[:m]))  # zero for dropped modes
    own_slopes = jnp.zeros(n).at[:m].set(jnp.diag(slopes[:m]))
    crossed = jnp.zeros((n, m)).at[:m].set(products[:m].T)  # [s, r] -> sum u_r f_s
    crossed_slopes = jnp.zeros((n, m)).at[:m].set(slopes[:m].T)
    gap = (modes.omega[None, :m] - modes.omega[:, None]) * (modes.omega[None, :m] + modes.omega[:, None])
    gap = jnp.where(diagonal | close, 1.0, gap)
    on_s = jnp.where(close, 0.5 * (slopes + own_slopes[:, None]), (products - own_products[:, None]) / gap)
    on_r = jnp.where(
        close, 0.5 * (own_slopes[None, :m] + crossed_slopes), (own_products[None, :m] - crossed) / gap
    )
    both = gamma[None, :m] * on_s + gamma[:, None] * on_r
    inertia = lam[None, :m] * both + jnp.where(
        kept, gamma[None, :m] * own_products[:, None] + gamma[:, None] * crossed, 0.0
    )

    def symmetric(pairs, own):
        half = 0.5 * jnp.where(diagonal, 0.0, pairs)
        square = jnp.zeros((n, n)).at[:, :m].set(half)
        dropped = jnp.where(kept, 0.0, half)
        return square + jnp.zeros((n, n)).at[:m, :].set(dropped.T) + jnp.diag(own)

    grad_stiffness = symmetric(both, gamma * own_slopes)
    grad_mass = -symmetric(inertia, gamma * (own_products + lam * own_slopes))
    force = gamma[:m] * modes.step * grad_damping
    return (
        jnp.einsum("ir,rs,is->i", modes.shapes, grad_mass, modes.shapes) + modes.shapes @ own_products,
        jnp.einsum("ir,rs,is->i", modes.drifts, grad_stiffness, modes.drifts),
        jnp.stack([force.sum(), force @ lam[:m]]),
        jnp.zeros(n).at[:m].set(2.0 * modes.omega[:m] * force),
    )


def response_gradient(op, static, parameters, record, dt, sensors, cotangent):
    """Gradients of sum W y."""
    return gradient(op, static, parameters, record, dt, sensors, cotangent, None)


def misfit_gradient(op, static, parameters, record, dt, sensors, observed, weights):
    """Gradients of the sum of weights (s, 1) or (s, 4) times the statistics of the misfit."""
    common = (parameters, record, dt, sensors)
    if weights.shape[1] == 1:
        return gradient(op, static, *common, observed, weights[:, 0])
    _, transpose = jax.vjp(statistics, observed - response(op, static, *common))
    return gradient(op, static, *common, -transpose(weights)[0], None)


def response_tangent(op, static, parameters, record, dt, sensors, *directions):
    """Derivative of the response: the transpose of its gradient."""
    total = Sampling(record, dt, *static[:2]).total
    zeros = jnp.zeros((sensors.shape[0], total))
    _, transpose = jax.vjp(lambda w: gradient(op, static, parameters, record, dt, sensors, w, None), zeros)
    return valid_only(op, static, parameters, record, dt, transpose(directions)[0])


def discrepancy_tangent(op, static, parameters, record, dt, sensors, observed, *directions):
    """Derivative of the discrepancy: the transpose of its gradient."""
    zeros = jnp.zeros(sensors.shape[0])
    _, transpose = jax.vjp(
        lambda c: gradient(op, static, parameters, record, dt, sensors, observed, c), zeros
    )
    return valid_only(op, static, parameters, record, dt, transpose(directions)[0])


def valid_only(op, static, parameters, record, dt, tangent):
    """The tangent, or NaN where the parameters describe no structure: a transpose does not see that."""
    substeps, _, n_modes = static
    return jnp.where(Modes(op, parameters, dt / substeps, n_modes, record[1]).valid, tangent, jnp.nan)


def without_gradient(*values):
    """Cotangents of the settings, which have none."""

    def of(x):
        if jnp.issubdtype(jnp.result_type(x), jnp.floating):
            return jnp.zeros_like(x)
        return np.zeros(np.shape(x), jax.dtypes.float0)

    return jax.tree.map(of, values)


def with_exact_derivative(function, backward):
    """The function of (op, static, parameters, record, ...), differentiated by `backward`."""
    differentiable = jax.custom_vjp(function, nondiff_argnums=(0, 1))
    differentiable.defvjp(lambda op, static, *inputs: (function(op, static, *inputs), inputs), backward)
    return differentiable


def response_backward(op, static, inputs, cotangent):
    return (gradient(op, static, *inputs, cotangent, None), *without_gradient(*inputs[1:]))


def discrepancy_backward(op, static, inputs, weights):
    *common, observed = inputs
    misfit = jnp.where(jnp.isnan(observed), 0.0, observed - response(op, static, *common))
    grad_data = weights[:, None] * (2.0 / observed.shape[1]) * misfit
    return (gradient(op, static, *inputs, weights), *without_gradient(*common[1:]), grad_data)


def misfit_backward(op, static, inputs, cotangent):
    *common, observed = inputs
    _, transpose = jax.vjp(statistics, observed - response(op, static, *common))
    [grad_data] = transpose(cotangent)
    return (gradient(op, static, *common, -grad_data, None), *without_gradient(*common[1:]), grad_data)


def statistics(misfit):
    """`ops.comparison.misfit_values` in JAX."""
    squares = ((x**2).sum(axis=1) / misfit.shape[1] for x in (misfit, jnp.diff(misfit, axis=1)))
    return jnp.stack([*squares, misfit[:, 0], misfit[:, -1]], axis=-1)


differentiable_response = with_exact_derivative(response, response_backward)
differentiable_discrepancy = with_exact_derivative(discrepancy, discrepancy_backward)
differentiable_misfit = with_exact_derivative(misfit_statistics, misfit_backward)
