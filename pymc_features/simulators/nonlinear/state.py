"""Equations of motion of a chain with nonlinear springs, `LANES` springs at a time.

The state is three blocks of p numbers, p the number of degrees of freedom n rounded up to full vectors:
displacements u and velocities v relative to the base, and one internal variable z for each spring. Its slope
holds their time derivatives,

    m_i v_i' = f_{i+1} - f_i - (C v)_i - m_i a_g,   f_i, z_i' = spring(d_i, d_i', z_i),   d_i = u_i - u_{i-1}.

What lies beyond n has no drift and stays zero.

Everything a step works with lies in one piece of memory, known by its address (`lane_bits.aligned`) to the
law: blocks of p numbers, which are `law.rows` vectors.
"""

import numpy as np

from pymc_features.simulators.chain.modal_damping import damping_coefficients
from pymc_features.simulators.chain.modes import chain_modes
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import (
    above,
    aligned,
    below,
    read_lanes,
    read_number,
    write_lanes,
    write_number,
)
from pymc_features.simulators.nonlinear.law import PARAMETERS, is_law, spring

N_STAGES = 7  # states and slopes of a step: at its start, at five stages, and at its end
LAST = N_STAGES - 1

# Blocks behind the law's parameters: 1 below n and 0 beyond; 1/m; k; beta k; alpha; three scalars; kinks
# passed in this step; the springs' branches (1 or -1), which are part of the state
ACTIVE, INVERSE_MASS, STIFFNESS, DASHPOT, DRAG, SCALARS, PASSED = range(PARAMETERS, PARAMETERS + 7)
BRANCH = PASSED + 2
STATES = BRANCH + 1
SLOPES = STATES + 3 * N_STAGES
MODAL = SLOPES + 3 * N_STAGES  # M^-1 C of damping by modal ratios: n columns, then n rows
# Scalars: highest rate of change of the linear chain [1/s]; whether MODAL is used; what divides every step
OMEGA, DAMPED, REFINE = range(3)


def padded(n: int) -> int:
    """The number n rounded up to full vectors."""
    return LANES * -(-n // LANES)


def chain_memory(n: int) -> np.ndarray:
    """Memory of a chain of n degrees of freedom, at rest."""
    return aligned((MODAL + 2 * n) * padded(n))


@jit
def state(law, s):
    """Where the state of stage `s` begins, in vectors."""
    return (STATES + 3 * s) * law.rows


@jit
def slope(law, s):
    """Where the slope of stage `s` begins, in vectors."""
    return (SLOPES + 3 * s) * law.rows


@jit
def constant(law, name, row):
    """Group `row` of one of the blocks above."""
    return read_lanes(law.address, name * law.rows + row)


@jit
def scalar(law, name):
    """One of the scalars above."""
    return read_number(law.address, SCALARS * law.rows * LANES + name)


@jit
def put(address, rows, block, i, value):
    """Write number `i` of a block."""
    write_number(address, block * rows * LANES + i, value)


@jit
def describe(law, parameters):
    """Write the constants of a chain, and its law's parameters; what lies beyond is as the last spring."""
    mass, stiffness, rayleigh, _, values = parameters
    address, rows, n = law.address, law.rows, law.n
    for i in range(rows * LANES):
        spring = min(i, n - 1)
        inside = 1.0 if i < n else 0.0
        for k in range(values.shape[0]):
            put(address, rows, k, i, values[k, spring])
        put(address, rows, ACTIVE, i, inside)
        put(address, rows, INVERSE_MASS, i, inside / mass[spring])
        put(address, rows, STIFFNESS, i, stiffness[spring])
        put(address, rows, DASHPOT, i, inside * rayleigh[1] * stiffness[spring])
        put(address, rows, DRAG, i, inside * rayleigh[0])
        for block in range(PASSED, MODAL):
            put(address, rows, block, i, 1.0 if block == BRANCH else 0.0)


@jit
def prepare(law, parameters, refine):
    """Write what describes a chain into its memory, which is at rest then; False if it is no chain.

    `parameters`: masses (n,), initial stiffnesses (n,), Rayleigh pair (2,), damping ratios (n,), and the
    law's (rows, n). `refine` divides every step.
    """
    mass, stiffness, rayleigh, ratios, _ = parameters
    n = mass.size
    describe(law, parameters)
    omega, participation, shapes = np.empty(n), np.empty(n), np.empty((n, n))
    valid = chain_modes(mass, stiffness, omega, shapes, participation)
    highest = 0.0
    any_ratio = False
    for r in range(n):
        valid &= is_law(law, r)
        drag = rayleigh[0] + rayleigh[1] * omega[r] ** 2 + 2.0 * ratios[r] * omega[r]
        valid &= 0.0 <= drag < np.inf
        highest = max(highest, omega[r] + drag)
        any_ratio |= ratios[r] != 0.0
    put(law.address, law.rows, SCALARS, OMEGA, highest)
    put(law.address, law.rows, SCALARS, REFINE, refine)
    put(law.address, law.rows, SCALARS, DAMPED, 1.0 if any_ratio else 0.0)
    if valid and any_ratio:
        matrix = damping_coefficients(mass, omega, shapes, ratios)
        for i in range(n):
            for j in range(n):
                put(law.address, law.rows, MODAL + j, i, matrix[i, j])
                put(law.address, law.rows, MODAL + n + i, j, matrix[i, j])
    return valid


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
    upper = splat(0.0)
    for row in range(law.rows - 1, -1, -1):
        v = read_lanes(law.address, here + law.rows + row)
        memory = read_lanes(law.address, here + 2 * law.rows + row)
        drift, rate = deformation(law, here, row)
        branch = constant(law, BRANCH, row)
        force, change = spring(law, row, constant(law, STIFFNESS, row), drift, rate, memory, branch)
        force = force + constant(law, DASHPOT, row) * rate
        push = constant(law, INVERSE_MASS, row) * (above(force, upper) - force)
        push = push - constant(law, DRAG, row) * v - ground * constant(law, ACTIVE, row)
        write_lanes(law.address, target + row, v)
        write_lanes(law.address, target + law.rows + row, push)
        write_lanes(law.address, target + 2 * law.rows + row, change)
        upper = force
    if scalar(law, DAMPED) > 0.0:
        subtract_product(law, MODAL, here + law.rows, target + law.rows)


@jit
def subtract_product(law, matrix, factor, target):
    """Subtract from the block at `target` the sum of the n blocks from `matrix` on, each times a factor."""
    for row in range(law.rows):
        result = read_lanes(law.address, target + row)
        for j in range(law.n):
            weight = read_number(law.address, factor * LANES + j)
            result = result - weight * constant(law, matrix + j, row)
        write_lanes(law.address, target + row, result)
