"""Transposed derivative of one step of a nonlinear chain: from the gradient behind it to that before it.

With the weights A of the stages, X_s = x + h sum_e A_se k_e and k_s the slope at X_s, the gradient with
respect to the step's result, X_6, goes back through the stages in reverse,

    kappa_s = sum_{r > s} A_rs Xbar_r,    Xbar_s = h (dk_s/dX_s)' kappa_s,    xbar = sum_s Xbar_s,

and each stage adds to the gradient with respect to the parameters.
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import (
    above,
    below,
    read_lanes,
    read_number,
    total,
    write_lanes,
    write_number,
)
from pymc_features.simulators.nonlinear.kinks import kink_function
from pymc_features.simulators.nonlinear.law import partials
from pymc_features.simulators.nonlinear.runge_kutta import TIMES, WEIGHTS, try_step
from pymc_features.simulators.nonlinear.state import (
    ACTIVE,
    BRANCH,
    DAMPED,
    DASHPOT,
    DRAG,
    INVERSE_MASS,
    LAST,
    MODAL,
    STIFFNESS,
    constant,
    deformation,
    scalar,
    slope,
    state,
)
from pymc_features.simulators.nonlinear.step_tangent import (
    CARRY,
    OF_DASHPOT,
    OF_MASS,
    OF_MODAL,
    OF_STIFFNESS,
    length_tangent,
    move,
    of_slope,
    of_state,
)


@jit
def add(law, work, block, row, value):
    """Add to group `row` of a block."""
    here = block * law.rows + row
    write_lanes(work, here, read_lanes(work, here) + value)


@jit
def pull_spring(law, work, s, step, row):
    """Add the gradient by the springs' parameters; return those by drifts, rates and internal variables."""
    rows, here, bars = law.rows, state(law, s), of_slope(law, s) + law.rows
    stiffness, active = constant(law, STIFFNESS, row), constant(law, ACTIVE, row)
    push = constant(law, INVERSE_MASS, row) * (step * read_lanes(work, bars + row))
    last = splat(0.0)
    if row > 0:
        last = constant(law, INVERSE_MASS, row - 1) * (step * read_lanes(work, bars + row - 1))
    force = active * (below(last, push) - push)
    change = step * read_lanes(work, bars + rows + row)
    drift, rate = deformation(law, here, row)
    memory = read_lanes(law.address, here + 2 * rows + row)
    branch = constant(law, BRANCH, row)
    by_force, by_change = partials(law, row, stiffness, drift, rate, memory, branch)
    add(law, work, OF_STIFFNESS, row, by_force[0] * force + by_change[0] * change)
    add(law, work, OF_DASHPOT, row, force * rate)
    for k in range(len(by_force) - 4):
        add(law, work, k, row, by_force[4 + k] * force + by_change[4 + k] * change)
    by_drift = active * (by_force[1] * force + by_change[1] * change)
    by_rate = active * ((by_force[2] + constant(law, DASHPOT, row)) * force + by_change[2] * change)
    return by_drift, by_rate, by_force[3] * force + by_change[3] * change


@jit
def slope_adjoint(law, work, s, step, ground):
    """Write Xbar_s from kappa_s, which is where the derivative of the slope lies."""
    rows, address = law.rows, law.address
    velocities, rates, bars = state(law, s) + rows, slope(law, s) + rows, of_slope(law, s)
    target, upper_drift, upper_rate = of_state(law, s), splat(0.0), splat(0.0)
    for row in range(rows - 1, -1, -1):
        by_drift, by_rate, by_memory = pull_spring(law, work, s, step, row)
        bar = step * read_lanes(work, bars + rows + row)
        v, drag = read_lanes(address, velocities + row), constant(law, DRAG, row)
        inertia = read_lanes(address, rates + row) + drag * v + ground * constant(law, ACTIVE, row)
        add(law, work, OF_MASS, row, bar * inertia)
        by_v = step * read_lanes(work, bars + row) - drag * bar + by_rate - above(by_rate, upper_rate)
        for j in range(law.n):
            add(law, work, OF_MODAL + j, row, (0.0 - read_number(address, velocities * LANES + j)) * bar)
        if scalar(law, DAMPED) > 0.0:
            for i in range(law.n):
                weight = step * read_number(work, (bars + rows) * LANES + i)
                by_v = by_v - weight * constant(law, MODAL + law.n + i, row)
        write_lanes(work, target + row, by_drift - above(by_drift, upper_drift))
        write_lanes(work, target + rows + row, by_v)
        write_lanes(work, target + 2 * rows + row, by_memory)
        upper_drift, upper_rate = by_drift, by_rate


@jit
def pull(law, work, s):
    """Write kappa_s from the stages behind it."""
    for row in range(3 * law.rows):
        bar = splat(0.0)
        for r in range(s + 1, LAST + 1):
            bar = bar + WEIGHTS[r, s] * read_lanes(work, of_state(law, r) + row)
        write_lanes(work, of_slope(law, s) + row, bar)


@jit
def step_adjoint(law, work, step, ground, trend):
    """Turn the gradient by a step's result into that by its start, both in stage `LAST`."""
    for s in range(LAST - 1, -1, -1):
        pull(law, work, s)
        slope_adjoint(law, work, s, step, ground + TIMES[s] * step * trend)
    for row in range(3 * law.rows):
        bar = read_lanes(work, of_state(law, LAST) + row)
        for s in range(LAST):
            bar = bar + read_lanes(work, of_state(law, s) + row)
        write_lanes(work, of_state(law, LAST) + row, bar)


@jit
def length_adjoint(law, work, step, trend):
    """Gradients by the length of a step and by the ground acceleration at its start, after `step_adjoint`."""
    by_step, by_ground, by_rise = splat(0.0), splat(0.0), splat(0.0)
    for s in range(LAST):
        for row in range(3 * law.rows):
            bar = read_lanes(work, of_slope(law, s) + row)
            by_step = by_step + bar * read_lanes(law.address, slope(law, s) + row)
            if law.rows <= row < 2 * law.rows:
                by_ground = by_ground - bar
                by_rise = by_rise - TIMES[s] * bar
    return total(by_step) + step * trend * total(by_rise), step * total(by_ground)


@jit
def remove_time(law, work, step, trend, which, by_time):
    """Replace the gradient by the result of a step of free length by that of one which ends at a kink.

    The kink lies where g = 0, so that the length changes by dh = -(dg at fixed h) / (dg/dh). `by_time` is the
    gradient by the time at which the step ends.
    """
    move(law, work, of_state(law, LAST), CARRY * law.rows, 1.0)
    length_tangent(law, work, step, trend)
    excess = splat(0.0)
    for row in range(3 * law.rows):
        change = read_lanes(work, of_state(law, LAST) + row)
        excess = excess + change * read_lanes(work, CARRY * law.rows + row)
    factor = (total(excess) + by_time) / kink_function(law, work, of_state(law, LAST), which)
    move(law, work, CARRY * law.rows, of_state(law, LAST), 1.0)
    first, p = of_state(law, LAST) * LANES, law.rows * LANES
    here = first + (p + which if which < law.n else 2 * p + which - law.n)
    write_number(work, here, read_number(work, here) - factor)
    if 0 < which < law.n:
        write_number(work, here - 1, read_number(work, here - 1) + factor)


@jit
def reverse_step(law, work, step, ground, trend, which, by_time):
    """Carry the gradient, in stage `LAST`, back over an accepted step; return that by the time of its start.

    The chain's memory holds the state at the start, and its slope. A step ends at kink `which` or, if -1, at
    a fixed time.
    """
    try_step(law, step, ground, trend)
    if which >= 0:
        remove_time(law, work, step, trend, which, by_time)
    step_adjoint(law, work, step, ground, trend)
    by_step, by_ground = length_adjoint(law, work, step, trend)
    return trend * by_ground + (by_time if which >= 0 else -by_step)
