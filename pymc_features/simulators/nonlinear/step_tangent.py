"""Derivative of one step of a nonlinear chain along a direction of state, parameters and length.

All that is computed here lies in memory of its own (`derivative_memory`), as the chain's does in its own.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import (
    above,
    aligned,
    below,
    read_lanes,
    read_number,
    write_lanes,
)
from pymc_features.simulators.nonlinear.law import PARAMETERS, partials, spring
from pymc_features.simulators.nonlinear.runge_kutta import TIMES, WEIGHTS
from pymc_features.simulators.nonlinear.state import (
    ACTIVE,
    BRANCH,
    DAMPED,
    DASHPOT,
    DRAG,
    INVERSE_MASS,
    LAST,
    MODAL,
    N_STAGES,
    STIFFNESS,
    constant,
    deformation,
    padded,
    scalar,
    slope,
    state,
)

# Blocks: of the law's parameters, stiffness, 1/m (directions) or m (gradients), beta k, alpha, the direction
# or the gradient; the state's, all stages; their slopes'; then the n columns of M^-1 C of modal ratios
OF_STIFFNESS, OF_MASS, OF_DASHPOT, OF_DRAG = range(PARAMETERS, PARAMETERS + 4)
CARRY = OF_DRAG + 1
OF_STATES = CARRY + 3
OF_SLOPES = OF_STATES + 3 * N_STAGES
OF_MODAL = OF_SLOPES + 3 * N_STAGES


def derivative_memory(n: int) -> np.ndarray:
    """Memory for the derivatives of a chain of n degrees of freedom, zero."""
    return aligned((OF_MODAL + n) * padded(n))


@jit
def of_state(law, s):
    """Where the derivative of the state of stage `s` begins, in vectors."""
    return (OF_STATES + 3 * s) * law.rows


@jit
def of_slope(law, s):
    """Where the derivative of the slope of stage `s` begins, in vectors."""
    return (OF_SLOPES + 3 * s) * law.rows


@jit
def own(law, work, name, row):
    """Group `row` of one of the blocks above."""
    return read_lanes(work, name * law.rows + row)


@jit
def deformation_tangent(law, work, here, row):
    """Derivatives of the drifts and of their rates of the springs of group `row`."""
    u, v = read_lanes(work, here + row), read_lanes(work, here + law.rows + row)
    u_last = v_last = splat(0.0)
    if row > 0:
        u_last, v_last = read_lanes(work, here + row - 1), read_lanes(work, here + law.rows + row - 1)
    active = constant(law, ACTIVE, row)
    return active * (u - below(u_last, u)), active * (v - below(v_last, v))


@jit
def force_tangent(law, work, s, row, along):
    """Derivatives of forces and of rates of internal variables, of group `row`; and the forces themselves."""
    here, stiffness = state(law, s), constant(law, STIFFNESS, row)
    memory = read_lanes(law.address, here + 2 * law.rows + row)
    drift, rate = deformation(law, here, row)
    of_drift, of_rate = deformation_tangent(law, work, of_state(law, s), row)
    of_memory = read_lanes(work, of_state(law, s) + 2 * law.rows + row)
    branch = constant(law, BRANCH, row)
    by_force, by_change = partials(law, row, stiffness, drift, rate, memory, branch)
    force = by_force[1] * of_drift + by_force[2] * of_rate + by_force[3] * of_memory
    change = by_change[1] * of_drift + by_change[2] * of_rate + by_change[3] * of_memory
    force = force + constant(law, DASHPOT, row) * of_rate
    value = splat(0.0)
    if along > 0.0:
        direction = own(law, work, OF_STIFFNESS, row)
        force = force + by_force[0] * direction + own(law, work, OF_DASHPOT, row) * rate
        change = change + by_change[0] * direction
        for k in range(len(by_force) - 4):
            direction = own(law, work, k, row)
            force = force + by_force[4 + k] * direction
            change = change + by_change[4 + k] * direction
        value = spring(law, row, stiffness, drift, rate, memory, branch)[0]
        value = value + constant(law, DASHPOT, row) * rate
    return force, change, value


@jit
def slope_tangent(law, work, s, of_ground, along):
    """Write the derivative of the slope of stage `s`; `along`: 1, or 0 without that by the parameters."""
    rows, upper, upper_value = law.rows, splat(0.0), splat(0.0)
    here, target = of_state(law, s), of_slope(law, s)
    for row in range(rows - 1, -1, -1):
        of_v = read_lanes(work, here + rows + row)
        force, change, value = force_tangent(law, work, s, row, along)
        push = constant(law, INVERSE_MASS, row) * (above(force, upper) - force)
        push = push - constant(law, DRAG, row) * of_v - of_ground * constant(law, ACTIVE, row)
        if along > 0.0:
            push = push + own(law, work, OF_MASS, row) * (above(value, upper_value) - value)
            v = read_lanes(law.address, state(law, s) + rows + row)
            push = push - own(law, work, OF_DRAG, row) * v
            for j in range(law.n):
                v_j = read_number(law.address, (state(law, s) + rows) * LANES + j)
                push = push - v_j * own(law, work, OF_MODAL + j, row)
        if scalar(law, DAMPED) > 0.0:
            for j in range(law.n):
                of_v_j = read_number(work, (here + rows) * LANES + j)
                push = push - of_v_j * constant(law, MODAL + j, row)
        write_lanes(work, target + row, of_v)
        write_lanes(work, target + rows + row, push)
        write_lanes(work, target + 2 * rows + row, change)
        upper, upper_value = force, value


@jit
def combine_tangent(law, work, step, of_step, s):
    """Write the derivative of the state of stage `s` from those before."""
    for row in range(3 * law.rows):
        change = read_lanes(work, of_state(law, 0) + row)
        for e in range(s):
            change = change + step * WEIGHTS[s, e] * read_lanes(work, of_slope(law, e) + row)
            change = change + of_step * WEIGHTS[s, e] * read_lanes(law.address, slope(law, e) + row)
        write_lanes(work, of_state(law, s) + row, change)


@jit
def step_tangent(law, work, step, trend, of_step, of_ground, along):
    """Write the derivative of a step, whose stages are in the chain's memory, to stage `LAST`.

    `of_step`, `of_ground`: of its length and of the ground acceleration at its start; stage 0 holds that of
    the state there, and `along` is 1, or 0 without the direction of the parameters.
    """
    for s in range(LAST):
        slope_tangent(law, work, s, of_ground + TIMES[s] * trend * of_step, along)
        combine_tangent(law, work, step, of_step, s + 1)


@jit
def move(law, work, source, target, factor):
    """Copy the derivative of a state, times a factor, within the memory."""
    for row in range(3 * law.rows):
        write_lanes(work, target + row, factor * read_lanes(work, source + row))


@jit
def add_multiple(law, work, source, target, factor):
    """Add the derivative of a state, times a factor, to another."""
    for row in range(3 * law.rows):
        change = read_lanes(work, target + row) + factor * read_lanes(work, source + row)
        write_lanes(work, target + row, change)


@jit
def length_tangent(law, work, step, trend):
    """Write the derivative of a step by its length to stage `LAST`."""
    move(law, work, of_state(law, 0), of_state(law, 0), 0.0)
    step_tangent(law, work, step, trend, 1.0, 0.0, 0.0)
