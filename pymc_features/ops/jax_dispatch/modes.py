"""Modes of one chain in JAX, and the step coefficients of `simulators.recursion`."""

import jax
import jax.numpy as jnp
from jax import lax

from pymc_features.simulators.oscillators.close_modes import CLOSE
from pymc_features.simulators.oscillators.fast_modes import FAST, N_ORDERS, STIFFEST
from pymc_features.simulators.oscillators.hold import TAYLOR_TERMS

MAX_HALVINGS = 24  # of the largest admissible frequency
MOST_GRADED = 1e10  # ratio of squared frequencies up to which they are right
STATIC = 1e-12  # (omega h)^2 of a mode that does not move in any record
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


def following(square, damping, order):
    """What stands before a, a', ... (5, m) in the output of modes that follow; see `fast_modes`."""
    c = [1.0 / square]
    c.append(-damping * c[0] / square)
    for k in range(2, N_ORDERS - order):
        c.append((-damping * c[k - 1] - c[k - 2]) / square)
    return jnp.stack([jnp.zeros_like(square)] * order + [-x for x in c[: N_ORDERS - order]])


class Modes:
    """Modes of one chain, and the coefficients of their recursion."""

    def __init__(self, op, parameters, step, n_modes, direct):
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
        self.valid = possible & jnp.all((s < jnp.inf) & (d >= 0.0) & (d < jnp.inf))
        self.valid &= s.max() <= MOST_GRADED * jnp.where(s > STATIC, s, jnp.inf).min()
        self.slope = rayleigh[1] + ratios / omega
        order = 2 if op.quantity in ACCELERATIONS else int(op.quantity == "relative_velocity")
        self.is_fast = (s > (FAST if direct.size else STIFFEST) ** 2) | (d >= STIFFEST)
        square, damping_of = jnp.where(self.is_fast, omega**2, 1.0), jnp.where(self.is_fast, damping, 0.0)
        one, none = jnp.ones_like(s), jnp.zeros_like(s)
        self.following, self.by_square = jax.jvp(
            lambda square, damping: following(square, damping, order),
            (square, damping_of),
            (one, self.slope),
        )
        self.by_damping = jax.jvp(lambda x: following(square, x, order), (damping_of,), (one,))[1]
        is_stepped = self.valid & ~self.is_fast
        s, d = jnp.where(is_stepped, s, one), jnp.where(is_stepped, d, none)
        self.hold, self.hold_derivative = jax.jvp(
            lambda s: step_coefficients(s, d), (s,), (jnp.ones_like(s),)
        )
        self.s, self.d, self.damping, self.ratios = s, d, damping, ratios
        self.quantity = op.quantity

    def outputs(self, q, p, ground):
        """Modal outputs of states (u, m), and of the ground's values and derivatives (u, 5).

        Accelerations are relative to the ground.
        """
        if self.quantity in ACCELERATIONS:
            stepped = -self.s * q - self.d * p - ground[:, :1]
        else:
            stepped = self.step * p if self.quantity == "relative_velocity" else self.step**2 * q
        return jnp.where(self.is_fast, ground @ self.following, stepped)

    def slopes(self, q, p, y, z, ground):
        """Derivatives of the outputs with respect to the eigenvalue, in total, and to d."""
        a = -q - self.d * z - self.s * y
        if self.quantity in ACCELERATIONS:
            by_s, by_d = a, -p - self.d * a - self.s * z
        elif self.quantity == "relative_velocity":
            by_s, by_d = self.step * z, self.step * a
        else:
            by_s, by_d = self.step**2 * y, self.step**2 * z
        in_total = self.step**2 * by_s + self.step * self.slope * by_d
        return (
            jnp.where(self.is_fast, ground @ self.by_square, in_total),
            jnp.where(self.is_fast, ground @ self.by_damping / self.step, by_d),
        )

    def close(self, duration):
        """Pairs of kept modes that take the derivative; see `simulators.pairs`."""
        omega, decay = self.omega[: self.n_modes], 0.5 * self.damping
        memory = jnp.maximum(jnp.minimum(duration, 1.0 / decay), 3.0 / omega)
        gap = jnp.abs(omega[:, None] - omega)
        near = (gap * jnp.minimum(memory[:, None], memory) < CLOSE) & (self.ratios[:, None] == self.ratios)
        return (near | (gap == 0.0)) & ~jnp.eye(self.n_modes, dtype=bool)
