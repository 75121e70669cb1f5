"""Equations of motion of a chain with nonlinear springs, `LANES` springs at a time.

The state is displacements u and velocities v relative to the base, and one internal variable z for each
spring. Its slope holds their time derivatives,

    u_i' = v_i,
    v_i' = (f_{i+1} - f_i) / m_i - alpha v_i - (M^-1 C v)_i - a_g,
    f_i, z_i' = spring(d_i, d_i', z_i),    d_i = u_i - u_{i-1},

where f includes the dashpot beta k_i d_i' and C is the damping by modal ratios. What lies in the padding
beyond n has no drift and stays zero. See `layout.py` for where all of it lies.

Damping by modal ratios as a function of masses and springs, and its derivatives.

With the modes phi_r of K phi = lambda M phi, phi' M phi = 1, the damping of Eq. (19)'s chain is

    M^-1 C = sum_r c_r P_r,   c_r = 2 zeta_r omega_r,   P_r = phi_r phi_r' M.

The projectors P_r of A = M^-1 K change by sum_s (P_r dA P_s + P_s dA P_r) / (lambda_r - lambda_s), so that

    d(M^-1 C) = sum_rs f_rs P_r dA P_s + sum_r 2 omega_r dzeta_r P_r,
    f_rs = (c_r - c_s) / (lambda_r - lambda_s) = (zeta_r + zeta_s) / (omega_r + omega_s)
                                                 + (zeta_r - zeta_s) / (omega_r - omega_s)

and f_rr = zeta_r / omega_r (Daleckii & Krein; see `pairs.py`). Without the second term, which is zero for
equal ratios, it is right at repeated frequencies too; with it the damping jumps where the modes cross.
"""

import numpy as np

from pymc_features.simulators.chain.modes import chain_modes
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.nonlinear.law import (
    ACTIVE,
    BRANCH,
    CROSSINGS,
    DASHPOT,
    HAS_MODAL_DAMPING,
    INVERSE_MASS,
    LINEAR_RATE,
    MASS_DAMPING,
    MODAL_DAMPING,
    REFINE,
    SCALARS,
    STIFFNESS,
    constant,
    is_admissible,
    put,
    scalar,
    spring,
)
from pymc_features.simulators.numbers.vectors import LANES, above, below, load, read_number, splat, store
from pymc_features.simulators.oscillators.modal_system import modal_damping


@jit
def product(a, b, transposed, scale):
    """The matrix a diag(scale) b or, if `transposed`, a' diag(scale) b: loops compile faster than algebra."""
    n = scale.size
    result = np.zeros((n, n))
    for i in range(n):
        for k in range(n):
            factor = scale[k] * (a[k, i] if transposed else a[i, k])
            for j in range(n):
                result[i, j] += factor * b[k, j]
    return result


@jit
def damping_coefficients(mass, omega, shapes, ratios):
    """M^-1 C (n, n); the rows of `shapes` (n, n) are the modes of `modal.chain_modes`."""
    n = mass.size
    weights = np.empty(n)
    for r in range(n):
        weights[r] = 2.0 * ratios[r] * omega[r]
    result = product(shapes, shapes, True, weights)
    for i in range(n):
        for j in range(n):
            result[i, j] *= mass[j]
    return result


@jit
def divided_difference(omega, ratios, r, s):
    """f_rs of a pair of modes."""
    difference = (ratios[r] + ratios[s]) / (omega[r] + omega[s])
    if ratios[r] != ratios[s]:
        difference += (ratios[r] - ratios[s]) / (omega[r] - omega[s])
    return difference


@jit
def drift(shapes, r, i):
    """Drift of spring `i` in mode `r`."""
    return shapes[r, i] - (shapes[r, i - 1] if i > 0 else 0.0)


@jit
def damping_tangent(mass, omega, shapes, ratios, directions):
    """Derivative (n, n) of M^-1 C along directions of mass, stiffness and ratios, each (n,)."""
    d_mass, d_stiffness, d_ratios = directions
    n = mass.size
    inner, ones = np.zeros((n, n)), np.ones(n)
    for r in range(n):
        for s in range(n):
            for i in range(n):  # phi_r' (dK - lambda_s dM) phi_s
                inner[r, s] += drift(shapes, r, i) * d_stiffness[i] * drift(shapes, s, i)
                inner[r, s] -= shapes[r, i] * d_mass[i] * shapes[s, i] * omega[s] * omega[s]
            inner[r, s] *= divided_difference(omega, ratios, r, s)
        inner[r, r] += 2.0 * omega[r] * d_ratios[r]
    result = product(product(shapes, inner, True, ones), shapes, False, ones)
    for i in range(n):
        for j in range(n):
            result[i, j] *= mass[j]
    return result


@jit
def add_damping_gradient(mass, omega, shapes, ratios, cotangent, gradients):
    """Add to the gradients by mass, stiffness and ratios what the `cotangent` (n, n) of M^-1 C gives."""
    d_mass, d_stiffness, d_ratios = gradients
    n = mass.size
    half = product(shapes, cotangent, False, np.ones(n))
    for r in range(n):
        for s in range(n):
            inner = 0.0
            for j in range(n):  # phi_r' B M phi_s
                inner += half[r, j] * mass[j] * shapes[s, j]
            if r == s:
                d_ratios[r] += 2.0 * omega[r] * inner
            inner *= divided_difference(omega, ratios, r, s)
            for i in range(n):
                d_stiffness[i] += inner * drift(shapes, r, i) * drift(shapes, s, i)
                d_mass[i] -= inner * shapes[r, i] * shapes[s, i] * omega[s] * omega[s]


@jit
def describe(law, parameters):
    """Write the constants of a chain at rest, the law's among them; the padding is as the last spring."""
    mass, stiffness, rayleigh, _, values = parameters
    n = law.n
    for i in range(law.rows * LANES):
        nearest = min(i, n - 1)
        inside = 1.0 if i < n else 0.0
        for k in range(values.shape[0]):
            put(law, k, i, values[k, nearest])
        put(law, ACTIVE, i, inside)
        put(law, INVERSE_MASS, i, inside / mass[nearest])
        put(law, STIFFNESS, i, stiffness[nearest])
        put(law, DASHPOT, i, inside * rayleigh[1] * stiffness[nearest])
        put(law, MASS_DAMPING, i, inside * rayleigh[0])
        for block in range(CROSSINGS, MODAL_DAMPING):
            put(law, block, i, 1.0 if block == BRANCH else 0.0)


@jit
def prepare(law, parameters, refine):
    """Write what describes a chain into its memory, which is at rest then; False if it is no chain.

    `parameters` are `NonlinearParameters` of one chain; `refine` divides every step.
    """
    mass, stiffness, rayleigh, ratios, _ = parameters
    n = mass.size
    describe(law, parameters)
    omega, participation, shapes = np.empty(n), np.empty(n), np.empty((n, n))
    valid = chain_modes(mass, stiffness, omega, shapes, participation)
    linear_rate = 0.0
    any_ratio = False
    for r in range(n):
        valid &= is_admissible(law, r)
        damping = modal_damping(omega[r], rayleigh, ratios[r])
        valid &= 0.0 <= damping < np.inf
        linear_rate = max(linear_rate, omega[r] + damping)
        any_ratio |= ratios[r] != 0.0
    put(law, SCALARS, LINEAR_RATE, linear_rate)
    put(law, SCALARS, REFINE, refine)
    put(law, SCALARS, HAS_MODAL_DAMPING, 1.0 if any_ratio else 0.0)
    if valid and any_ratio:
        matrix = damping_coefficients(mass, omega, shapes, ratios)
        for i in range(n):
            for j in range(n):
                put(law, MODAL_DAMPING + j, i, matrix[i, j])
    return valid


@jit
def has_modal_damping(law):
    """Whether the chain is damped by modal ratios."""
    return scalar(law, HAS_MODAL_DAMPING) > 0.0


@jit
def deformation(law, first, row):
    """Drifts and their rates of the springs of group `row` in the state, or slope, at `first`."""
    u, v = load(law.address, first + row), load(law.address, first + law.rows + row)
    u_last = v_last = splat(0.0)
    if row > 0:
        u_last = load(law.address, first + row - 1)
        v_last = load(law.address, first + law.rows + row - 1)
    active = constant(law, ACTIVE, row)
    return active * (u - below(u_last, u)), active * (v - below(v_last, v))


@jit
def write_slope(law, ground, here, target):
    """Write the time derivative of the state at `here` to `target`; `ground` acceleration in m/s^2."""
    upper = splat(0.0)  # forces of the springs of the next group
    for row in range(law.rows - 1, -1, -1):
        v = load(law.address, here + law.rows + row)
        z = load(law.address, here + 2 * law.rows + row)
        drift, rate = deformation(law, here, row)
        branch = constant(law, BRANCH, row)
        force, z_rate = spring(law, row, constant(law, STIFFNESS, row), drift, rate, z, branch)
        force = force + constant(law, DASHPOT, row) * rate
        acceleration = constant(law, INVERSE_MASS, row) * (above(force, upper) - force)
        acceleration = acceleration - constant(law, MASS_DAMPING, row) * v
        acceleration = acceleration - ground * constant(law, ACTIVE, row)
        store(law.address, target + row, v)
        store(law.address, target + law.rows + row, acceleration)
        store(law.address, target + 2 * law.rows + row, z_rate)
        upper = force
    if has_modal_damping(law):
        subtract_modal_damping(law, here + law.rows, target + law.rows)


@jit
def subtract_modal_damping(law, velocities, target):
    """Subtract M^-1 C v, column by column, from the accelerations at `target`."""
    for row in range(law.rows):
        result = load(law.address, target + row)
        for j in range(law.n):
            v = read_number(law.address, velocities * LANES + j)
            result = result - v * constant(law, MODAL_DAMPING + j, row)
        store(law.address, target + row, result)
