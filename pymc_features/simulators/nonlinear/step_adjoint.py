"""Transposed derivative of one step of a nonlinear chain: from the gradient at its end to that at its start.

With the stages X_s = x + h sum_e A_se k_e of a step, L a scalar and bars for its derivatives, the gradient
Xbar_6 by the step's result goes back through the stages in reverse,

    kbar_s = h sum_{r > s} A_rs Xbar_r,    Xbar_s = (dk_s/dX_s)' kbar_s,    xbar = sum_s Xbar_s,

and each stage adds kbar_s' dk_s/dp to the gradient by a parameter p. The derivatives by the length of the
step and by the ground acceleration at its start, where a_g(s) = ground + c_s h trend, are

    dL/dh = 1/h sum_s kbar_s' k_s + trend sum_s c_s dL/da_g(s),    dL/dground = sum_s dL/da_g(s),

with dL/da_g(s) the negative sum of kbar_s over the accelerations.

The gradient's memory has the layout of the chain's (`layout.py`): Xbar_s lies at `state(law, s)` and kbar_s
at `slope(law, s)` behind the address `grad`.
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
from pymc_features.simulators.nonlinear.kinks import kink_value
from pymc_features.simulators.nonlinear.law import partials
from pymc_features.simulators.nonlinear.layout import (
    ACTIVE,
    BRANCH,
    DASHPOT,
    INVERSE_MASS,
    LAST,
    MASS_DAMPING,
    MODAL_DAMPING,
    STIFFNESS,
    constant,
    slope,
    state,
)
from pymc_features.simulators.nonlinear.runge_kutta import TIMES, WEIGHTS, try_step
from pymc_features.simulators.nonlinear.state import deformation, has_modal_damping

NEGLIGIBLE = 1e-7


@jit
def add(law, grad, block, row, value):
    """Add to group `row` of a block of the gradient."""
    here = block * law.rows + row
    write_lanes(grad, here, read_lanes(grad, here) + value)


@jit
def spring_adjoint(law, grad, s, row):
    """Add the gradient by the springs' parameters; return those by drifts, their rates and z."""
    rows, here, rates = law.rows, state(law, s), slope(law, s)
    stiffness, active = constant(law, STIFFNESS, row), constant(law, ACTIVE, row)
    # v_i' contains (f_{i+1} - f_i) / m_i, so that dL/df_i is that of mass i - 1 less that of mass i
    push = constant(law, INVERSE_MASS, row) * read_lanes(grad, rates + rows + row)
    last = splat(0.0)
    if row > 0:
        last = constant(law, INVERSE_MASS, row - 1) * read_lanes(grad, rates + rows + row - 1)
    grad_force = active * (below(last, push) - push)
    grad_z_rate = read_lanes(grad, rates + 2 * rows + row)
    drift, rate = deformation(law, here, row)
    z = read_lanes(law.address, here + 2 * rows + row)
    branch = constant(law, BRANCH, row)
    # chain rule through (f, z') = spring(k, d, d', z, parameters) and the dashpot beta k d' within f
    of_force, of_z_rate = partials(law, row, stiffness, drift, rate, z, branch)
    add(law, grad, STIFFNESS, row, of_force[0] * grad_force + of_z_rate[0] * grad_z_rate)
    add(law, grad, DASHPOT, row, grad_force * rate)
    for k in range(len(of_force) - 4):
        add(law, grad, k, row, of_force[4 + k] * grad_force + of_z_rate[4 + k] * grad_z_rate)
    grad_drift = of_force[1] * grad_force + of_z_rate[1] * grad_z_rate
    grad_rate = (of_force[2] + constant(law, DASHPOT, row)) * grad_force + of_z_rate[2] * grad_z_rate
    grad_z = of_force[3] * grad_force + of_z_rate[3] * grad_z_rate
    return active * grad_drift, active * grad_rate, grad_z


@jit
def slope_adjoint(law, grad, s, ground):
    """Write Xbar_s = (dk_s/dX_s)' kbar_s, and add the gradient by the parameters."""
    rows, here, rates = law.rows, state(law, s), slope(law, s)
    upper_drift, upper_rate = splat(0.0), splat(0.0)
    for row in range(rows - 1, -1, -1):
        grad_drift, grad_rate, grad_z = spring_adjoint(law, grad, s, row)
        acceleration_bar = read_lanes(grad, rates + rows + row)
        v, alpha = read_lanes(law.address, here + rows + row), constant(law, MASS_DAMPING, row)
        # 1/m dv'/d(1/m): acceleration by the springs' forces; `collect` takes modal damping out of it
        by_springs = read_lanes(law.address, rates + rows + row) + alpha * v
        by_springs = by_springs + ground * constant(law, ACTIVE, row)
        add(law, grad, INVERSE_MASS, row, acceleration_bar * by_springs)
        add(law, grad, MASS_DAMPING, row, (0.0 - v) * acceleration_bar)
        if has_modal_damping(law):
            for j in range(law.n):  # v_i' contains - (M^-1 C)_ij v_j
                v_j = read_number(law.address, (here + rows) * LANES + j)
                add(law, grad, MODAL_DAMPING + j, row, (0.0 - v_j) * acceleration_bar)
        # u' = v, v' = ... - alpha v - M^-1 C v, and v_i takes part in the drift rates d_i' and d_{i+1}'
        grad_v = read_lanes(grad, rates + row) - alpha * acceleration_bar
        grad_v = grad_v + grad_rate - above(grad_rate, upper_rate)
        if has_modal_damping(law):
            for i in range(law.n):
                bar = read_number(grad, (rates + rows) * LANES + i)
                grad_v = grad_v - bar * constant(law, MODAL_DAMPING + law.n + i, row)
        write_lanes(grad, here + row, grad_drift - above(grad_drift, upper_drift))
        write_lanes(grad, here + rows + row, grad_v)
        write_lanes(grad, here + 2 * rows + row, grad_z)
        upper_drift, upper_rate = grad_drift, grad_rate


@jit
def step_adjoint(law, grad, step, ground, trend):
    """Turn the gradient by a step's result into that by its start; both lie at stage `LAST`.

    Returns the gradients by the length of the step and by the ground acceleration at its start.
    """
    for s in range(LAST - 1, -1, -1):
        for row in range(3 * law.rows):
            bar = splat(0.0)
            for r in range(s + 1, LAST + 1):
                bar = bar + WEIGHTS[r, s] * read_lanes(grad, state(law, r) + row)
            write_lanes(grad, slope(law, s) + row, step * bar)
        slope_adjoint(law, grad, s, ground + TIMES[s] * step * trend)
    by_slopes, grad_ground, by_times = splat(0.0), splat(0.0), splat(0.0)
    for row in range(3 * law.rows):
        xbar = read_lanes(grad, state(law, LAST) + row)
        for s in range(LAST):
            xbar = xbar + read_lanes(grad, state(law, s) + row)
            kbar = read_lanes(grad, slope(law, s) + row)
            by_slopes = by_slopes + kbar * read_lanes(law.address, slope(law, s) + row)
            if law.rows <= row < 2 * law.rows:  # v' contains -a_g
                grad_ground = grad_ground - kbar
                by_times = by_times - TIMES[s] * kbar
        write_lanes(grad, state(law, LAST) + row, xbar)
    return total(by_slopes) / step + trend * total(by_times), total(grad_ground)


@jit
def subtract_kink(law, grad, which, factor):
    """Subtract from Xbar_6 a multiple of dg/dX_6, where the kink function g is v_i - v_{i-1} or z_i."""
    p = law.rows * LANES
    here = state(law, LAST) * LANES + (p + which if which < law.n else 2 * p + which - law.n)
    write_number(grad, here, read_number(grad, here) - factor)
    if 0 < which < law.n:
        write_number(grad, here - 1, read_number(grad, here - 1) + factor)


@jit
def kink_adjoint(law, grad, recorded_step, grad_time):
    """As `step_adjoint` for a step that ends at a kink; returns the gradient by the time of its start.

    The kink lies where g = 0, so that the length of the step depends on its start: dh = -dg / (dg/dh), with
    dg at constant h. The gradient is that at constant h for Xbar_6 - lambda dg/dX_6, where lambda makes the
    derivative by h vanish, with the part `grad_time` by the time of the kink. X_6 changes with h by the slope
    k_6 but for the error of the method: that gives lambda, and a second sweep makes up what is left of the
    derivative, if it is more than `NEGLIGIBLE` of what it was.
    """
    step, ground, trend, which = recorded_step
    by_length = splat(0.0)
    for row in range(3 * law.rows):
        xbar = read_lanes(grad, state(law, LAST) + row)
        by_length = by_length + xbar * read_lanes(law.address, slope(law, LAST) + row)
        write_lanes(grad, slope(law, LAST) + row, splat(0.0))  # kbar_6 is not used: the sum of the sweeps
    g_rate = kink_value(law, LAST, which)[1]
    residual, grad_ground = total(by_length) + grad_time, 0.0
    for _ in range(2):
        subtract_kink(law, grad, which, residual / g_rate)
        grad_step, part = step_adjoint(law, grad, step, ground, trend)
        left, grad_ground = grad_step + grad_time, grad_ground + part
        for row in range(3 * law.rows):
            sweep = read_lanes(grad, state(law, LAST) + row)
            sweeps = read_lanes(grad, slope(law, LAST) + row) + sweep
            write_lanes(grad, slope(law, LAST) + row, sweeps)
            write_lanes(grad, state(law, LAST) + row, splat(0.0))
        if abs(left) <= NEGLIGIBLE * abs(residual):
            break
        residual = left
    for row in range(3 * law.rows):
        write_lanes(grad, state(law, LAST) + row, read_lanes(grad, slope(law, LAST) + row))
    return grad_time + trend * grad_ground  # a kink at a given state moves with the start of the step


@jit
def reverse_step(law, grad, recorded_step, grad_time):
    """Carry the gradient, at stage `LAST`, back over a recorded step; return that by the time of its start.

    The chain's memory holds the state at the start, and its slope. A step ends at a kink or, if its number is
    -1, at a given time; `grad_time` is the gradient by the time of its end.
    """
    step, ground, trend, which = recorded_step
    try_step(law, step, ground, trend)
    if which >= 0:
        return kink_adjoint(law, grad, recorded_step, grad_time)
    grad_step, grad_ground = step_adjoint(law, grad, step, ground, trend)
    return trend * grad_ground - grad_step  # a later start shortens a step whose end is given
