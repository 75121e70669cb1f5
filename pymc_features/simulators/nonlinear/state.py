"""Equations of motion of a chain with nonlinear springs, `LANES` springs at a time.

The state is displacements u and velocities v relative to the base, and one internal variable z for each
spring. Its slope holds their time derivatives,

    u_i' = v_i,
    v_i' = (f_{i+1} - f_i) / m_i - alpha v_i - (M^-1 C v)_i - a_g,
    f_i, z_i' = spring(d_i, d_i', z_i),    d_i = u_i - u_{i-1},

where f includes the dashpot beta k_i d_i' and C is the damping by modal ratios. What lies in the padding
beyond n has no drift and stays zero. See `layout.py` for where all of it lies.
"""

import numpy as np

from pymc_features.simulators.chain.modal_damping import damping_coefficients
from pymc_features.simulators.chain.modes import chain_modes
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import (
    above,
    below,
    read_lanes,
    read_number,
    write_lanes,
)
from pymc_features.simulators.nonlinear.law import is_admissible, spring
from pymc_features.simulators.nonlinear.layout import (
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
    put,
    scalar,
)
from pymc_features.simulators.oscillators.recursion import modal_damping


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
    u, v = read_lanes(law.address, first + row), read_lanes(law.address, first + law.rows + row)
    u_last = v_last = splat(0.0)
    if row > 0:
        u_last = read_lanes(law.address, first + row - 1)
        v_last = read_lanes(law.address, first + law.rows + row - 1)
    active = constant(law, ACTIVE, row)
    return active * (u - below(u_last, u)), active * (v - below(v_last, v))


@jit
def write_slope(law, ground, here, target):
    """Write the time derivative of the state at `here` to `target`; `ground` acceleration in m/s^2."""
    upper = splat(0.0)  # forces of the springs of the next group
    for row in range(law.rows - 1, -1, -1):
        v = read_lanes(law.address, here + law.rows + row)
        z = read_lanes(law.address, here + 2 * law.rows + row)
        drift, rate = deformation(law, here, row)
        branch = constant(law, BRANCH, row)
        force, z_rate = spring(law, row, constant(law, STIFFNESS, row), drift, rate, z, branch)
        force = force + constant(law, DASHPOT, row) * rate
        acceleration = constant(law, INVERSE_MASS, row) * (above(force, upper) - force)
        acceleration = acceleration - constant(law, MASS_DAMPING, row) * v
        acceleration = acceleration - ground * constant(law, ACTIVE, row)
        write_lanes(law.address, target + row, v)
        write_lanes(law.address, target + law.rows + row, acceleration)
        write_lanes(law.address, target + 2 * law.rows + row, z_rate)
        upper = force
    if has_modal_damping(law):
        subtract_modal_damping(law, here + law.rows, target + law.rows)


@jit
def subtract_modal_damping(law, velocities, target):
    """Subtract M^-1 C v, column by column, from the accelerations at `target`."""
    for row in range(law.rows):
        result = read_lanes(law.address, target + row)
        for j in range(law.n):
            v = read_number(law.address, velocities * LANES + j)
            result = result - v * constant(law, MODAL_DAMPING + j, row)
        write_lanes(law.address, target + row, result)
