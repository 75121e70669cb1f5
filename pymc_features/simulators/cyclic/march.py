"""From the displacement of a specimen to its force, by Dormand and Prince's method along each branch.

Between two given displacements the path is straight. It is integrated in x, the way gone over d_y, from the
state (w, e, r), r the way that is left:

    w' = F(w, e),    e' = w,    r' = -1.

A step that would carry w across zero ends there instead, exactly: w itself becomes the independent variable
(M. Henon, Physica D 5 (1982) 412-414),

    w' = 1,    e' = w / F,    r' = -1 / F.

So all steps are on one side of the kink of the law. Their lengths follow from the difference to the embedded
method of fourth order, and, where loops are pinched, from the width of the pinch.

Derivatives by the parameters are carried along: what is differentiated is the method itself, with the parts
in which the steps divide what is left as they were found.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.cyclic.law import (
    BETA,
    D_NU,
    D_PSI,
    GAMMA,
    PSI,
    RATIO,
    REACH,
    SEVERITY,
    SHARPNESS,
    SLIP,
    SLIP_RATE,
    STIFFNESS,
    Q,
    is_specimen,
    rate,
)
from pymc_features.simulators.oscillators.arguments import ground_at

# J. R. Dormand & P. J. Prince, J. Comput. Appl. Math. 6 (1980) 19-26, table 2 (RK5(4)7M); the last row gives
# the result, ERROR the difference to the result of fourth order.
STAGES = np.array(
    [
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (1 / 5, 0.0, 0.0, 0.0, 0.0, 0.0),
        (3 / 40, 9 / 40, 0.0, 0.0, 0.0, 0.0),
        (44 / 45, -56 / 15, 32 / 9, 0.0, 0.0, 0.0),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0.0, 0.0),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0.0),
        (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
    ]
)
ERROR = np.array([71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])
LAST = 6

TOLERANCE = 1e-9  # of w and of e / (1 + e) in one step
FIRST_STEP, LONGEST_STEP = 0.1, 1.0  # in units of d_y
NEAR_ZERO, SMOOTH = 2e-3, 3.0  # a step at w = 0, and n from which none is needed
MOST_STEPS = 5000  # between two displacements
W, E, LEFT = range(3)


@jit
def take_step(law, state, change, step, step_change, by_w, work):
    """Write the result of a step and its derivatives; return its error.

    Parameters
    ----------
    state, change : array (3,), (3, columns)
        w, e and r, and their derivatives by the parameters; no columns if none are wanted.
    step, step_change : float, array (columns,)
        Length in x, or in w.
    by_w : bool
        Whether w is the independent variable.
    work : tuple of array
        Slopes (7, 3) and (7, 3, columns), result (3,) and (3, columns), and partial derivatives.
    """
    slopes, slope_changes, new, new_change, partials = work
    columns = change.shape[1]
    sign = -1.0 if state[W] < 0.0 else 1.0
    for s in range(LAST + 1):
        for i in range(3):
            total = 0.0
            for b in range(s):
                total += STAGES[s, b] * slopes[b, i]
            new[i] = state[i] + step * total
            for p in range(columns):
                inner = 0.0
                for b in range(s):
                    inner += STAGES[s, b] * slope_changes[b, i, p]
                new_change[i, p] = change[i, p] + step * inner + step_change[p] * total
        w = new[W]
        value = rate(law, w, new[E], sign, partials)
        if by_w:
            slopes[s, W], slopes[s, E], slopes[s, LEFT] = 1.0, w / value, -1.0 / value
        else:
            slopes[s, W], slopes[s, E], slopes[s, LEFT] = value, w, -1.0
        for p in range(columns):
            d_w = new_change[W, p]
            d_value = partials[0] * d_w + partials[1] * new_change[E, p] + partials[2 + p]
            if by_w:
                slope_changes[s, W, p] = 0.0
                slope_changes[s, E, p] = (d_w - w / value * d_value) / value
                slope_changes[s, LEFT, p] = d_value / (value * value)
            else:
                slope_changes[s, W, p] = d_value
                slope_changes[s, E, p] = d_w
                slope_changes[s, LEFT, p] = 0.0
    return step_error(state, slopes, step, by_w)


@jit
def step_error(state, slopes, step, by_w):
    """Largest error of a step: of w, or of the way that is left, and of e beside 1 + e."""
    of_first, of_energy = 0.0, 0.0
    for s in range(LAST + 1):
        of_first += ERROR[s] * slopes[s, LEFT if by_w else W]
        of_energy += ERROR[s] * slopes[s, E]
    return abs(step) * max(abs(of_first), abs(of_energy) / (1.0 + abs(state[E])))


@jit
def longest(law, w, e, columns):
    """A step that cannot miss the pinch: half its width, or half the distance to it.

    Nor, where derivatives are wanted, the singularity of |w|^n log|w| at zero, the derivative by n.
    """
    near = LONGEST_STEP
    if columns and law[SHARPNESS] < SMOOTH:
        near = max(NEAR_ZERO, 0.5 * abs(w))
    if law[SLIP] == 0.0:
        return near
    zeta_1 = law[SLIP] * (1.0 - np.exp(-law[SLIP_RATE] * e))
    zeta_2 = (law[PSI] + law[D_PSI] * e) * (law[SEVERITY] + zeta_1)
    z_u = ((1.0 + law[D_NU] * e) * (law[BETA] + law[GAMMA])) ** (-1.0 / law[SHARPNESS])
    return min(near, LONGEST_STEP, max(0.5 * zeta_2, 0.5 * abs(w - law[Q] * z_u)))


@jit
def go(law, state, change, suggested, step_change, work):
    """Take a specimen along a straight path, `state[LEFT]` long; return a step for the next one, or NaN."""
    _, _, new, new_change, _ = work
    for _ in range(MOST_STEPS):
        left = state[LEFT]
        if left <= 0.0:
            return suggested
        part = min(suggested, longest(law, state[W], state[E], change.shape[1])) / left
        part = 1.0 if part >= 1.0 else min(part, 0.5)
        step_change[:] = part * change[LEFT]
        error = take_step(law, state, change, part * left, step_change, False, work)
        factor = 0.9 * (TOLERANCE / max(error, 1e-5 * TOLERANCE)) ** 0.2
        if not error <= TOLERANCE:
            if not error < np.inf:
                return np.nan
            suggested = max(factor, 0.1) * part * left
            continue
        longer = min(factor, 5.0) * part * left
        suggested = min(max(longer, suggested) if part == 1.0 else longer, LONGEST_STEP)
        if state[W] < 0.0 < new[W]:
            to_zero(law, state, change, part, step_change, work)
        elif part == 1.0:
            new[LEFT] = 0.0
        state[:] = new
        change[:] = new_change
    return np.nan


@jit
def to_zero(law, state, change, part, step_change, work):
    """Step to w = 0, or, if that is too far for one step, on the way to it."""
    _, _, new, new_change, _ = work
    left, into = state[LEFT], 1.0
    while into > 1e-3:
        step_change[:] = -into * change[W]
        error = take_step(law, state, change, -into * state[W], step_change, True, work)
        if error <= TOLERANCE:
            break
        into *= 0.5
    if new[LEFT] < 0.0:  # by less than the errors, the way ends before
        step_change[:] = part * change[LEFT]
        take_step(law, state, change, part * left, step_change, False, work)
        new[LEFT] = 0.0 if part == 1.0 else new[LEFT]
    elif into == 1.0:
        new[W] = 0.0
        new_change[W] = 0.0


@jit
def march(law, excitation, force, gradient):
    """Write the force (u,) [N] at the output samples, and its derivatives (14, u) by the parameters.

    Parameters
    ----------
    law : array (14,)
        In the order of `law.NAMES`.
    excitation : Excitation
        The displacement [m] as its input. The specimen is untouched at the displacement zero.
    force, gradient : array (u,), (14, u) or (0, u)
        Written; NaN where the parameters describe no specimen, or the integration fails.
    """
    displacement, _, substeps, stride, _ = excitation
    columns = gradient.shape[0]
    state, change, step_change = np.zeros(3), np.zeros((3, columns)), np.zeros(columns)
    work = (
        np.zeros((LAST + 1, 3)),
        np.zeros((LAST + 1, 3, columns)),
        np.zeros(3),
        np.zeros((3, columns)),
        np.zeros(2 + columns if columns else 0),
    )
    k, reach, ratio = law[STIFFNESS], law[REACH], law[RATIO]
    suggested = FIRST_STEP if is_specimen(law) else np.nan
    before, direction = 0.0, 1.0
    for fine in range((displacement.size - 1) * substeps + 1):
        d = ground_at(displacement, fine, substeps)
        if d != before and suggested == suggested:
            if (d - before) * direction < 0.0:
                direction = -direction
                state[W] = -state[W]
                change[W] = -change[W]
            state[LEFT] = abs(d - before) / reach
            change[LEFT] = 0.0
            if columns:
                change[LEFT, REACH] = -state[LEFT] / reach
            suggested = go(law, state, change, suggested, step_change, work)
            before = d
        if fine % stride == 0:
            j = fine // stride
            z = direction * state[W]
            inner = (1.0 - ratio) * k
            force[j] = ratio * k * d + inner * reach * z
            if columns:
                gradient[:, j] = inner * reach * direction * change[W]
                gradient[STIFFNESS, j] += force[j] / k
                gradient[REACH, j] += inner * z
                gradient[RATIO, j] += k * (d - reach * z)
    if not np.isfinite(suggested):
        force[:] = np.nan
        gradient[:] = np.nan
