"""The model in JAX (optional): modes in a vector, `lax.scan` over time, float64.

Import only where JAX is installed. Taking 128 steps at a time, unrolled by four, with a matrix product for
the output gained a quarter at most and is left out for the sake of a readable competitor.
"""

import jax
import jax.numpy as jnp

from benchmarks.case import ALPHA, BETA
from benchmarks.hold import first_order_hold

jax.config.update("jax_enable_x64", True)


def chain_modes(stiffness):
    """Frequencies [rad/s], damping ratios, and phi_r Gamma_r (n, modes) for masses of 1 kg."""
    above = jnp.append(stiffness[1:], 0.0)
    matrix = jnp.diag(stiffness + above) - jnp.diag(above[:-1], 1) - jnp.diag(above[:-1], -1)
    eigenvalues, shapes = jnp.linalg.eigh(matrix)
    omega = jnp.sqrt(eigenvalues)
    return omega, 0.5 * (ALPHA / omega + BETA * omega), shapes * shapes.sum(axis=0)


def discrepancies(stiffness, ground, observed, sensors, step):
    """e_j of one chain, shape (s,); nothing of the history is stored in the forward pass."""
    omega, zeta, shapes = chain_modes(stiffness)
    hold = first_order_hold(omega, zeta, step, xp=jnp)
    shapes = shapes[sensors]

    def advance(carry, inputs):
        q, p, errors = carry
        before, now, data = inputs
        q, p = (
            hold.phi[i][0] * q + hold.phi[i][1] * p + hold.now[i] * before + hold.after[i] * now
            for i in (0, 1)
        )
        misfit = data - shapes @ (hold.out[0] * q + hold.out[1] * p)
        return (q, p, errors + misfit**2), None

    rest = jnp.zeros_like(omega)
    inputs = (ground[:-1], ground[1:], observed.T[1:])
    (_, _, errors), _ = jax.lax.scan(advance, (rest, rest, observed[:, 0] ** 2), inputs)
    return errors / ground.size


def log_likelihood(problem):
    """TN log-likelihood of `benchmarks.problem` as a JAX function of (theta, sigma)."""
    nominal = jnp.asarray(problem.parameters[1])
    ground, observed = jnp.asarray(problem.record.acceleration), jnp.asarray(problem.measured)
    sensors, step = problem.settings[1].sensors, problem.record.dt

    def function(theta, sigma):
        stiffness = nominal.at[:3].multiply(theta)
        e = discrepancies(stiffness, ground, observed, sensors, step)
        return e.size * (0.5 * jnp.log(2.0 / jnp.pi) - jnp.log(sigma)) - e.sum() / (2.0 * sigma**2)

    return function
