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
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, highest, magnitude, splat
from pymc_features.simulators.compiled.vector_math import larger
from pymc_features.simulators.compiled.vector_memory import (
    all_less,
    read_lanes,
    read_number,
    write_lanes,
    write_number,
)
from pymc_features.simulators.nonlinear.kinks import first_kink, kink_value, set_branches
from pymc_features.simulators.nonlinear.law import has_kinks, step_rate
from pymc_features.simulators.nonlinear.layout import (
    CROSSINGS,
    LAST,
    LINEAR_RATE,
    REFINE,
    STIFFNESS,
    constant,
    scalar,
    slope,
    state,
)
from pymc_features.simulators.nonlinear.state import deformation, write_slope

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
        change = step * weights[0] * read_lanes(law.address, slopes + row)
        for e in range(1, len(weights)):
            change = change + step * weights[e] * read_lanes(law.address, slopes + 3 * law.rows * e + row)
        write_lanes(law.address, target + row, read_lanes(law.address, here + row) + change)


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
        write_lanes(law.address, state(law, 0) + row, read_lanes(law.address, state(law, LAST) + row))
        write_lanes(law.address, slope(law, 0) + row, read_lanes(law.address, slope(law, LAST) + row))


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
        finite &= all_less(magnitude(read_lanes(law.address, state(law, 0) + row)), splat(np.inf))
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
