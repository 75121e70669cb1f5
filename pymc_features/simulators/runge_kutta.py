"""Steps of a chain with nonlinear springs: Dormand & Prince's fifth-order method, split at kinks.

The state is one flat array (3 n,): displacements u and velocities v relative to the base, then one internal
variable z for each spring; its slope holds their time derivatives,

    m_i v_i' = f_{i+1} - f_i - (C v)_i - m_i a_g,   f_i, z_i' = spring(d_i, d_i', z_i),   d_i = u_i - u_{i-1}.

A method of order 5 keeps its order only if the right-hand side is smooth within each step. It is not where
a hysteretic spring turns back (d' = 0) or its internal variable passes zero: a step across such a kink would
have a local error of second order. There the step ends at the kink, found by a cubic through the step's
ends and then by Newton's method, and a second step makes up the rest.

Nothing is tried and rejected: the length of a step is a function of the state at its start (`advance`),
and the state a deterministic function of the parameters.

References
----------
J. R. Dormand & P. J. Prince, J. Comput. Appl. Math. 6 (1980) 19-26, table 2 (RK5(4)7M).
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compilation import jit
from pymc_features.simulators.restoring import has_kinks, pace, spring

# Row s: weights of the slopes before stage s; the last row gives the step's result (first same as last).
STAGES = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
TIMES = np.array([0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1])
LAST = 6

PHASE = 0.2  # largest product of step and rate of change
VIBRATION = 1.5  # weight of the highest frequency in it: errors of phase add up over a free vibration
MAX_STEPS = 4000  # in one segment; more are needed by parameters far from any structure only
KINK_TOLERANCE = 1e-9  # of where a kink lies, in steps; the error left behind is proportional to it
NEWTON_STEPS = 4


class System(NamedTuple):
    """Inverse masses, springs [N/m], (alpha, beta), and M^-1 C of damping by modal ratios, or (0, 0)."""

    inverse_mass: np.ndarray
    stiffness: np.ndarray
    rayleigh: np.ndarray
    modal: np.ndarray


class Workspace(NamedTuple):
    """State (3 n,), slopes of all stages (7, 3 n), the state's own first; trial, kinks passed (2 n,)."""

    state: np.ndarray
    stages: np.ndarray
    trial: np.ndarray
    passed: np.ndarray


@jit
def write_slope(law, system, ground, state, slope):
    """Write the time derivative of a state under the ground acceleration `ground`."""
    n = system.stiffness.size
    alpha, beta = system.rayleigh[0], system.rayleigh[1]
    u_below = v_below = 0.0
    for i in range(n):
        u, v = state[i], state[n + i]
        rate = v - v_below
        force, slope[2 * n + i] = spring(law, i, system.stiffness[i], u - u_below, rate, state[2 * n + i])
        force += beta * system.stiffness[i] * rate
        slope[i] = v
        slope[n + i] = -force * system.inverse_mass[i] - alpha * v - ground
        if i > 0:
            slope[n + i - 1] += force * system.inverse_mass[i - 1]
        u_below, v_below = u, v
    for i in range(system.modal.shape[0]):
        drag = 0.0
        for j in range(n):
            drag += system.modal[i, j] * state[n + j]
        slope[n + i] -= drag


@jit
def try_step(law, system, work, step, ground, trend):
    """Write the state after `step` into `work.trial`, and its slope as the last stage.

    `ground` is the ground acceleration at the step's start [m/s^2], `trend` its slope [m/s^3].
    """
    for s in range(1, LAST + 1):
        work.trial[:] = work.state
        for earlier in range(s):
            weight = step * STAGES[s, earlier]
            for j in range(work.trial.size):
                work.trial[j] += weight * work.stages[earlier, j]
        write_slope(law, system, ground + TIMES[s] * step * trend, work.trial, work.stages[s])


@jit
def accept(work):
    """Make the trial state the state."""
    work.state[:] = work.trial
    work.stages[0] = work.stages[LAST]


@jit
def kink_function(state, which):
    """Drift rate of a spring (which < n) or its internal variable; of a slope, their time derivatives."""
    n = state.size // 3
    if which >= n:
        return state[n + which]
    return state[n + which] - (state[n + which - 1] if which > 0 else 0.0)


@jit
def cubic_root(before, after, slope_before, slope_after):
    """Root in (0, 1) of the cubic with these values and slopes at 0 and 1; the values differ in sign."""
    low, high = 0.0, 1.0
    x = before / (before - after)
    second = 3.0 * (after - before) - 2.0 * slope_before - slope_after
    third = 2.0 * (before - after) + slope_before + slope_after
    for _ in range(8):
        value = before + x * (slope_before + x * (second + x * third))
        if (value > 0.0) == (before > 0.0):
            low = x
        else:
            high = x
        x -= value / (slope_before + x * (2.0 * second + x * 3.0 * third))
        if not low <= x <= high:
            x = 0.5 * (low + high)
    return x


@jit
def first_kink(work, step):
    """The first kink of the trial step not yet passed, -1 if none, and where: a fraction of the step."""
    which, where = -1, 1.0
    for k in range(work.passed.size):
        before, after = kink_function(work.state, k), kink_function(work.trial, k)
        if work.passed[k] == 0 and before * after < 0.0:
            x = cubic_root(
                before,
                after,
                step * kink_function(work.stages[0], k),
                step * kink_function(work.stages[LAST], k),
            )
            if which < 0 or x < where:
                which, where = k, x
    return which, where


@jit
def step_forward(law, system, work, step, ground, trend):
    """Advance the state by `step`, in pieces that end at kinks, each kink at most once."""
    left = step
    try_step(law, system, work, left, ground, trend)
    if has_kinks(law):
        work.passed[:] = 0
        which, where = first_kink(work, left)
        while which >= 0:
            work.passed[which] = 1
            piece = where * left
            for iteration in range(NEWTON_STEPS):
                try_step(law, system, work, piece, ground, trend)
                miss = kink_function(work.trial, which) / kink_function(work.stages[LAST], which)
                better = piece - miss
                if (
                    abs(miss) < KINK_TOLERANCE * step
                    or not 0.0 < better < left
                    or iteration == NEWTON_STEPS - 1
                ):
                    break
                piece = better
            accept(work)
            ground += trend * piece
            left -= piece
            try_step(law, system, work, left, ground, trend)
            which, where = first_kink(work, left)
    accept(work)


@jit
def fastest(law, system, omega, work):
    """Rate of change [1/s] of the chain in its present state: what a step must resolve."""
    n = system.stiffness.size
    extra = 0.0
    u_below = 0.0
    for i in range(n):
        rate, change = kink_function(work.state, i), kink_function(work.stages[0], i)
        u = work.state[i]
        extra = max(extra, pace(law, i, system.stiffness[i], omega, u - u_below, rate, change))
        u_below = u
    return VIBRATION * omega + extra


@jit
def advance(law, system, omega, work, length, ground, trend, refine):
    """Advance the state over a segment of `length` [s] in which the ground acceleration is linear.

    Steps are so short that their product with `fastest` stays below `PHASE`, each divided by `refine`.
    Returns False where that takes too many steps or the state is not finite.
    """
    left = length
    for _ in range(MAX_STEPS):
        rate = fastest(law, system, omega, work)
        if not rate * left < PHASE * MAX_STEPS:
            return False
        count = max(np.ceil(left * rate / PHASE), 1.0)
        step = left / count
        for _ in range(refine):
            step_forward(law, system, work, step / refine, ground, trend)
            ground += trend * step / refine
        if count == 1.0:
            return bool(np.isfinite(work.state).all())
        left -= step
    return False
