"""Modes of one chain in JAX, and the step coefficients of `simulators.recursion`."""

import jax
import jax.numpy as jnp
from jax import lax

from pymc_features.simulators.oscillators.close_modes import CLOSE
from pymc_features.simulators.oscillators.hold import TAYLOR_TERMS

MAX_HALVINGS = 24  # of the largest admissible frequency
ACCELERATIONS = ("absolute_acceleration", "relative_acceleration")


def step_coefficients(s, d):
    """Transition and input coefficients (8, m) for s = (omega h)^2 and d = 2 zeta omega h (m,)."""
    size = lax.stop_gradient(jnp.maximum(jnp.maximum(s, d * d), 1e-300))
    halvings = jnp.clip(jnp.ceil(0.5 * jnp.log2(size / 0.0625)), 0, MAX_HALVINGS)
    full_s, full_d = s, d
    s, d = s * 4.0**-halvings, d * 2.0**-halvings
    a2, b2 = jnp.ones_like(s), jnp.zeros_like(s)
    for k in range(TAYLOR_TERMS, 2, -1):
        a2, b2 = 1.0 - s * b2 / k, (a2 - d * b2) / k
    a2, b2 = 0.5 * a2, 0.5 * b2
    a1, b1 = 1.0 - s * b2, a2 - d * b2
    a0, b0 = 1.0 - s * b1, a1 - d * b1

    def double(i, state):
        s, d, a0, b0, a1, b1, a2, b2 = state
        grown, mixed = 1.0 + a0, 1.0 + a0 - d * b0
        phi_0 = a0 * a0 - s * b0 * b0, 0.5 * b0 * (2.0 * a0 - d * b0)
        phi_1 = 0.5 * (grown * a1 - s * b0 * b1), 0.25 * (mixed * b1 + b0 * a1)
        phi_2 = 0.25 * (grown * a2 - s * b0 * b2 + a1), 0.125 * (mixed * b2 + b0 * a2 + b1)
        new = (4.0 * s, 2.0 * d, *phi_0, *phi_1, *phi_2)
        return tuple(jnp.where(i < halvings, x, old) for x, old in zip(new, state, strict=True))

    *_, a0, b0, a1, b1, a2, b2 = lax.fori_loop(0, MAX_HALVINGS, double, (s, d, a0, b0, a1, b1, a2, b2))
    s, d = full_s, full_d
    return jnp.stack([a0, b0, -s * b0, a0 - d * b0, b2 - b1, a2 - a1 - d * (b2 - b1), -b2, d * b2 - a2])


class Modes:
    """Modes of one chain, and the coefficients of their recursion."""

    def __init__(self, op, parameters, step, n_modes):
        mass, stiffness, rayleigh, ratios = parameters
        possible = jnp.all((mass > 0) & (mass < jnp.inf) & (stiffness > 0) & (stiffness < jnp.inf))
        mass, stiffness = jnp.where(possible, mass, 1.0), jnp.where(possible, stiffness, 1.0)
        root, above = jnp.sqrt(mass), jnp.append(stiffness[1:], 0.0)
        off = -above[:-1] / (root[:-1] * root[1:])
        matrix = jnp.diag((stiffness + above) / mass) + jnp.diag(off, 1) + jnp.diag(off, -1)
        shapes = jnp.linalg.eigh(matrix)[1] / root[:, None]  # (n, modes)
        inertia = mass @ shapes**2
        shapes = shapes * jnp.where(shapes[-1] >= 0.0, 1.0, -1.0) / jnp.sqrt(inertia)
        self.shapes = shapes
        self.drifts = jnp.diff(shapes, axis=0, prepend=jnp.zeros((1, shapes.shape[1])))
        self.eigenvalues = stiffness @ self.drifts**2  # Rayleigh quotients, without cancellation
        self.omega = jnp.sqrt(self.eigenvalues)
        self.participation = mass @ shapes
        self.n_modes, self.step = n_modes, step
        omega, ratios = self.omega[:n_modes], ratios[:n_modes]
        damping = rayleigh[0] + rayleigh[1] * omega**2 + 2.0 * ratios * omega  # 2 zeta omega
        s, d = (omega * step) ** 2, damping * step
        self.valid = possible & jnp.all((s < 1e12) & (d >= 0.0) & (d < 2e6))
        s, d = jnp.where(self.valid, s, 1.0), jnp.where(self.valid, d, 0.0)
        self.slope = rayleigh[1] + ratios / omega
        self.hold, self.hold_derivative = jax.jvp(
            lambda s: step_coefficients(s, d), (s,), (jnp.ones_like(s),)
        )
        self.s, self.d, self.damping, self.ratios = s, d, damping, ratios
        self.quantity = op.quantity

    def outputs(self, q, p, ground):
        """Modal outputs; accelerations are relative to the ground."""
        if self.quantity in ACCELERATIONS:
            return -self.s * q - self.d * p - ground
        return self.step * p if self.quantity == "relative_velocity" else self.step**2 * q

    def slopes(self, q, p, y, z):
        """Derivatives of the outputs with respect to the eigenvalue, in total, and to d."""
        a = -q - self.d * z - self.s * y
        if self.quantity in ACCELERATIONS:
            by_s, by_d = a, -p - self.d * a - self.s * z
        elif self.quantity == "relative_velocity":
            by_s, by_d = self.step * z, self.step * a
        else:
            by_s, by_d = self.step**2 * y, self.step**2 * z
        return self.step**2 * by_s + self.step * self.slope * by_d, by_d

    def close(self, duration):
        """Pairs of kept modes that take the derivative; see `simulators.pairs`."""
        omega, decay = self.omega[: self.n_modes], 0.5 * self.damping
        memory = jnp.maximum(jnp.minimum(duration, 1.0 / decay), 3.0 / omega)
        gap = jnp.abs(omega[:, None] - omega)
        near = (gap * jnp.minimum(memory[:, None], memory) < CLOSE) & (self.ratios[:, None] == self.ratios)
        return (near | (gap == 0.0)) & ~jnp.eye(self.n_modes, dtype=bool)
