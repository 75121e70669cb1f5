"""Steps of a chain with nonlinear springs: Dormand and Prince's fifth-order method, split at kinks.

With x the state, k_s the slope at stage s and h the length of the step, the method is

    X_s = x + h sum_{e < s} A_se k_e,    k_s = slope(X_s, a_g(t + c_s h)),    s = 0 ... 6,

and X_6 is its result. The order is 5 only if the slope is smooth within each step. It is not where a
hysteretic spring turns back (d' = 0) or its internal variable passes zero: a step across such a kink would
have a local error of second order. There the step ends at the kink, found by a cubic through the step's
ends and then by Newton's method, and a second step makes up the rest. All stages of a step are on one branch
of the law, so that the slope is smooth even where a stage lies a little beyond the kink.

No step is rejected: the number of steps is a function of the state at their start (`advance`), and the state
a deterministic function of the parameters.

References
----------
J. R. Dormand & P. J. Prince, J. Comput. Appl. Math. 6 (1980) 19-26, table 2 (RK5(4)7M).

Kinks of the law of a spring, found in a step so that steps can end there.

A law with kinks has one where a kink function passes zero. There are 2n of them: number k < n is the drift
rate of spring k, number n + k is its internal variable z. Within a step each is taken to be the cubic with
its values and slopes at both ends of the step (Hermite interpolation).
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.nonlinear.law import (
    BRANCH,
    CROSSINGS,
    LAST,
    LINEAR_RATE,
    REFINE,
    STIFFNESS,
    constant,
    has_kinks,
    scalar,
    slope,
    state,
    step_rate,
)
from pymc_features.simulators.nonlinear.state import deformation, write_slope
from pymc_features.simulators.numbers.compiled_numbers import highest, larger, magnitude, where_less
from pymc_features.simulators.numbers.vectors import (
    LANES,
    all_equal,
    all_less,
    any_less,
    load,
    read_number,
    splat,
    store,
    write_number,
)

MAX_CROSSINGS = 2.0  # of one kink in one step


@jit
def kink_function(law, here, which):
    """Kink function number `which` of the state at `here`; of a slope, its time derivative."""
    p = law.rows * LANES
    first = here * LANES
    if which >= law.n:
        return read_number(law.address, first + 2 * p + which - law.n)
    lower = read_number(law.address, first + p + which - 1) if which > 0 else 0.0
    return read_number(law.address, first + p + which) - lower


@jit
def kink_value(law, s, which):
    """The kink function at stage `s`, and its time derivative."""
    return kink_function(law, state(law, s), which), kink_function(law, slope(law, s), which)


@jit
def set_branches(law, ahead):
    """Set the springs' branches from the state extrapolated by `ahead` [s]; return whether any changed.

    The extrapolation is needed at a kink, where one of the two functions is zero but for rounding. If one
    stays zero, at rest, the spring is about to be loaded.
    """
    changed = False
    here, rates = state(law, 0), slope(law, 0)
    for row in range(law.rows):
        third = 2 * law.rows + row
        rate = deformation(law, here, row)[1] + ahead * deformation(law, rates, row)[1]
        z = load(law.address, here + third) + ahead * load(law.address, rates + third)
        branch = where_less(rate * z, splat(0.0), splat(-1.0), splat(1.0))
        changed |= not all_equal(branch, constant(law, BRANCH, row))
        store(law.address, BRANCH * law.rows + row, branch)
    return changed


@jit
def cubic(c, x):
    """Value of a polynomial with four coefficients, the constant one first."""
    return c[0] + x * (c[1] + x * (c[2] + x * c[3]))


@jit
def cubic_root(c, high):
    """Root in (0, high) of a cubic whose values at 0 and `high` differ in sign: Newton, kept in a bracket."""
    low, positive = 0.0, c[0] > 0.0
    x = high * c[0] / (c[0] - cubic(c, high))
    if not low <= x <= high:  # rounding errors have the signs that are not expected
        x = 0.5 * high
    for _ in range(8):
        value = cubic(c, x)
        if (value > 0.0) == positive:
            low = x
        else:
            high = x
        x -= value / (c[1] + x * (2.0 * c[2] + x * 3.0 * c[3]))
        if not low <= x <= high:
            x = 0.5 * (low + high)
    return x


@jit
def next_root(before, after, slope_before, slope_after, passed):
    """First root in (0, 1) of the cubic with these values and slopes at 0 and 1; 2 where there is none.

    With `passed` the value at 0 is a root but for its rounding error; the next one is wanted.
    """
    # Hermite interpolation: c0 + c1 x + c2 x^2 + c3 x^3
    second = 3.0 * (after - before) - 2.0 * slope_before - slope_after
    third = 2.0 * (before - after) + slope_before + slope_after
    c = (before, slope_before, second, third)
    if passed:  # divided by x, the cubic is a parabola
        ahead = slope_before * (after - before) < 0.0
        return cubic_root((slope_before, second, third, 0.0), 1.0) if ahead else 2.0
    if before * after < 0.0:
        return cubic_root(c, 1.0)
    if before * slope_before < 0.0 < after * slope_after:  # towards zero, then away: its extreme decides
        lowest = cubic_root((slope_before, 2.0 * second, 3.0 * third, 0.0), 1.0)
        if before * cubic(c, lowest) < 0.0:
            return cubic_root(c, lowest)
    return 2.0


@jit
def may_cross(before, after, change_before, change_after):
    """Whether functions with these values and changes, at a step's ends, may pass zero in it."""
    there = before * (before + change_before)
    back = after * (after - change_after)
    return any_less(before * after, splat(0.0)) or any_less(larger(there, back), splat(0.0))


@jit
def any_kink(law, step):
    """Whether a drift rate or an internal variable may pass zero in the step."""
    found = False
    start, end = state(law, 0), state(law, LAST)
    for row in range(law.rows):
        found |= may_cross(
            deformation(law, start, row)[1],
            deformation(law, end, row)[1],
            step * deformation(law, slope(law, 0), row)[1],
            step * deformation(law, slope(law, LAST), row)[1],
        )
        third = 2 * law.rows + row
        found |= may_cross(
            load(law.address, start + third),
            load(law.address, end + third),
            step * load(law.address, slope(law, 0) + third),
            step * load(law.address, slope(law, LAST) + third),
        )
    return found


@jit
def first_kink(law, step):
    """The first kink of the step still ahead, -1 if none, and where: a fraction of the step."""
    which, where = -1, 1.0
    if any_kink(law, step):
        first = CROSSINGS * law.rows * LANES
        for k in range(2 * law.n):
            times = read_number(law.address, first + k)
            if times < MAX_CROSSINGS:
                before, slope_before = kink_value(law, 0, k)
                after, slope_after = kink_value(law, LAST, k)
                x = next_root(before, after, step * slope_before, step * slope_after, times > 0.0)
                if x < where:
                    which, where = k, x
    return which, where


# A_se of stages 1 ... 6; the last row gives the step's result, whose slope starts the next step.
STAGES = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
TIMES = (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0)  # c_s

PHASE = 0.2  # largest product of step and rate of change
VIBRATION = 1.5  # weight of the linear chain's rate in it: errors of phase add up over a free vibration
MAX_STEPS = 4000  # in one segment; only parameters far from any structure need more
KINK_TOLERANCE = 1e-9  # of the position of a kink, in steps; the error left behind is proportional to it
NEWTON_STEPS = 4
AHEAD = 1e-6  # part of a step after which a kink at its start has been left behind


@jit
def combine(law, step, s, weights):
    """Write X_s of stage `s` from the slopes of the stages before; `weights` are the A_se."""
    here, target, slopes = state(law, 0), state(law, s), slope(law, 0)
    for row in range(3 * law.rows):
        change = step * weights[0] * load(law.address, slopes + row)
        for e in range(1, len(weights)):
            change = change + step * weights[e] * load(law.address, slopes + 3 * law.rows * e + row)
        store(law.address, target + row, load(law.address, here + row) + change)


@jit
def try_step(law, step, ground, trend):
    """Write the states and slopes of all stages of a step of this length, and its result.

    `ground` is the ground acceleration at the step's start [m/s^2], `trend` its slope [m/s^3].
    """
    rise = step * trend
    combine(law, step, 1, STAGES[0])
    write_slope(law, ground + TIMES[1] * rise, state(law, 1), slope(law, 1))
    combine(law, step, 2, STAGES[1])
    write_slope(law, ground + TIMES[2] * rise, state(law, 2), slope(law, 2))
    combine(law, step, 3, STAGES[2])
    write_slope(law, ground + TIMES[3] * rise, state(law, 3), slope(law, 3))
    combine(law, step, 4, STAGES[3])
    write_slope(law, ground + TIMES[4] * rise, state(law, 4), slope(law, 4))
    combine(law, step, 5, STAGES[4])
    write_slope(law, ground + rise, state(law, 5), slope(law, 5))
    combine(law, step, LAST, STAGES[5])
    write_slope(law, ground + rise, state(law, LAST), slope(law, LAST))


@jit
def accept(law):
    """Make the result of the step the state."""
    for row in range(3 * law.rows):
        store(law.address, state(law, 0) + row, load(law.address, state(law, LAST) + row))
        store(law.address, slope(law, 0) + row, load(law.address, slope(law, LAST) + row))


@jit
def step_to_kink(law, which, step, piece, ground, trend):
    """Make the step that ends at a kink, from a guess `piece` of its length; return the length."""
    for iteration in range(NEWTON_STEPS):  # g(piece) = 0, with dg/dt by the slope at the step's end
        try_step(law, piece, ground, trend)
        value, change = kink_value(law, LAST, which)
        miss = value / change
        better = piece - miss
        if abs(miss) < KINK_TOLERANCE * step or not 0.0 < better < step or iteration == NEWTON_STEPS - 1:
            break
        piece = better
    return piece


@jit
def begin_piece(law, step, ground):
    """Choose the branches of a step that begins at the present state, and renew the slope if they change."""
    if has_kinks(law) and set_branches(law, AHEAD * step):
        write_slope(law, ground, state(law, 0), slope(law, 0))


@jit
def pass_kinks(law, step, ground, trend):
    """Advance a step that has been tried through its kinks, in pieces, and try the rest behind the last one.

    Return the length of the rest and the ground acceleration at its start.
    """
    left = step
    first = CROSSINGS * law.rows * LANES
    which, where = first_kink(law, left)
    while which >= 0:
        write_number(law.address, first + which, 1.0 + read_number(law.address, first + which))
        piece = step_to_kink(law, which, left, where * left, ground, trend)
        accept(law)
        ground += trend * piece
        left -= piece
        begin_piece(law, left, ground)
        try_step(law, left, ground, trend)
        which, where = first_kink(law, left)
    if left < step:
        for k in range(2 * law.n):
            write_number(law.address, first + k, 0.0)
    return left, ground


@jit
def step_forward(law, step, ground, trend):
    """Advance the state by `step`, in pieces that end at kinks."""
    left = step
    begin_piece(law, step, ground)
    try_step(law, step, ground, trend)
    if has_kinks(law):
        left, ground = pass_kinks(law, step, ground, trend)
    accept(law)


@jit
def rate_of_change(law):
    """Rate of change [1/s] of the chain in its present state, which a step must resolve."""
    linear_rate = scalar(law, LINEAR_RATE)
    extra = splat(0.0)
    for row in range(law.rows):
        drift, rate = deformation(law, state(law, 0), row)
        acceleration = deformation(law, slope(law, 0), row)[1]
        stiffness, omega = constant(law, STIFFNESS, row), splat(linear_rate)
        extra = larger(extra, step_rate(law, row, stiffness, omega, drift, rate, acceleration))
    return VIBRATION * linear_rate + highest(extra)


@jit
def is_finite(law):
    """Whether the state is finite."""
    finite = True
    for row in range(3 * law.rows):
        finite &= all_less(magnitude(load(law.address, state(law, 0) + row)), splat(np.inf))
    return finite


@jit
def advance(law, length, ground, trend):
    """Advance the state over a segment of `length` [s] in which the ground acceleration is linear.

    Steps are so short that their product with `rate_of_change` stays below `PHASE`: what is left of the
    segment is divided by a whole number, and each step once more by `REFINE`. Returns False where that takes
    too many steps or the state is not finite.
    """
    left, refine = length, int(scalar(law, REFINE))
    for _ in range(MAX_STEPS):
        rate = rate_of_change(law)
        if not rate * left < PHASE * MAX_STEPS:
            return False
        count = max(np.ceil(left * rate / PHASE), 1.0)
        step = left / count
        for _ in range(refine):
            step_forward(law, step / refine, ground, trend)
            ground += trend * step / refine
        if count == 1.0:
            return is_finite(law)
        left -= step
    return False
