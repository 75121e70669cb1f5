"""The functions of the family of specimens; each takes NumPy arrays and runs compiled code.

A population is a loop over its particles, for each of which the history of the force is kept, and with a
gradient its derivatives by the fourteen parameters. That costs some 3 microseconds for each displacement, and
three times as much with the gradient.

The law of Bouc, Wen, Baber and Noori along a branch on which the displacement goes one way.

With the displacement d, the dimensionless internal variable z, at rest zero, and the dimensionless energy e,

    f = a k d + (1 - a) k d_y z,
    d_y z' = d' h(z, e) {1 - nu(e) |z|^n [gamma + beta sign(d' z)]} / eta(e),      d_y e' = z d',

where k is the initial stiffness, d_y the yield displacement and a the post-yield ratio; the hysteretic part
has taken up the energy (1 - a) k d_y^2 e. Strength and stiffness degrade with it, and loops are pinched:

    nu = 1 + delta_nu e,    eta = 1 + delta_eta e,
    h = 1 - zeta_1 exp{-[z sign(d') - q z_u]^2 / zeta_2^2},    z_u = [nu (beta + gamma)]^(-1/n),
    zeta_1 = zeta_s (1 - exp(-p e)),    zeta_2 = (psi + delta_psi e) (lambda + zeta_1).

Nothing here depends on time. With x the way gone since the last reversal, over d_y, and w = z sign(d'), one
branch obeys

    dw/dx = h (1 - nu |w|^n c) / eta,    de/dx = w,    c = gamma + beta sign(w).

w grows along it, and passes zero once at most: there c jumps and |w|^n has a kink.

References
----------
T. T. Baber & Y.-K. Wen, J. Eng. Mech. Div. ASCE 107 (1981) 1069-1087 (degradation). T. T. Baber & M. N.
Noori, J. Eng. Mech. 111 (1985) 1010-1026 and J. Vib. Acoust. 108 (1986) 411-420 (pinching). G. C. Foliente,
J. Struct. Eng. 121 (1995) 1013-1022: h, zeta_1, zeta_2 and z_u as above, here with A = 1, which no data can
tell from the other parameters (F. Ma et al., J. Appl. Mech. 71 (2004) 342-349).

From the displacement of a specimen to its force, by Dormand and Prince's method along each branch.

Between two given displacements the path is straight. It is integrated in x, the way gone over d_y, from the
state (w, e, r), r the way that is left:

    w' = F(w, e),    e' = w,    r' = -1.

A step that would carry w across zero ends there instead, exactly: w itself becomes the independent variable
(M. Henon, Physica D 5 (1982) 412-414),

    w' = 1,    e' = w / F,    r' = -1 / F.

So all steps are on one side of the kink of the law. Their lengths follow from the difference to the embedded
method of fourth order, and, where loops are pinched, from the width of the pinch.

Derivatives by the parameters are carried along by the numbers: what is differentiated is the method itself,
with the parts in which the steps divide what is left as they were found.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import chain, lanes, registers, scalar, with_slopes
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.numbers.vectors import new_numbers
from pymc_features.simulators.oscillators.arguments import Excitation, ground_at, n_outputs
from pymc_features.simulators.oscillators.misfit import measured_difference, statistics, weigh_history

NAMES = (
    "stiffness",
    "yield_displacement",
    "post_yield_ratio",
    "sharpness",
    "beta",
    "gamma",
    "strength_degradation",
    "stiffness_degradation",
    "slip",
    "slip_rate",
    "initiation",
    "spread",
    "spread_rate",
    "severity",
)
N_PARAMETERS = len(NAMES)
STIFFNESS, REACH, RATIO, SHARPNESS, BETA, GAMMA, D_NU, D_ETA, SLIP, SLIP_RATE, Q, PSI, D_PSI, SEVERITY = (
    range(N_PARAMETERS)
)


class SpecimenParameters(NamedTuple):
    """What a specimen is.

    Attributes
    ----------
    law : array (14,), of a population (p, 14)
        In the order of `NAMES`: k [N/m], d_y [m], a, n, beta, gamma, delta_nu, delta_eta, zeta_s, p, q, psi,
        delta_psi and lambda [-].
    """

    law: np.ndarray


@jit
def is_specimen(law):
    """Whether loops dissipate and no denominator vanishes: -beta < gamma <= beta, degradation, h > 0."""
    spring = 0.0 < law[STIFFNESS] < np.inf and 0.0 < law[REACH] < np.inf and 0.0 <= law[RATIO] <= 1.0
    shape = 1.0 <= law[SHARPNESS] < np.inf and 0.0 < law[BETA] < np.inf
    loops = shape and -law[BETA] < law[GAMMA] <= law[BETA]
    for i in (D_NU, D_ETA, SLIP, SLIP_RATE, Q, D_PSI):
        loops = loops and 0.0 <= law[i] < np.inf
    pinched = law[SLIP] < 1.0 and 0.0 < law[PSI] < np.inf and 0.0 < law[SEVERITY] < np.inf
    return spring and loops and pinched


W, E, LEFT = range(3)  # of the state
NEW, STAGE, LAW, OUT = (
    3,
    6,
    27,
    27 + N_PARAMETERS,
)  # behind it: a result, slopes of stages, parameters


@jit
def inverse(x):
    """1 / x."""
    value = 1.0 / scalar(x)
    return chain(x, value, -value * value)


@jit
def exponential(x):
    """e^x."""
    value = np.exp(scalar(x))
    return chain(x, value, value)


@jit
def power(size, n):
    """|w|^n; `size` is w or -w, by the side of the law."""
    x, order = abs(scalar(size)), scalar(n)
    steep = x if order == 2.0 else 1.0 if order == 1.0 else x ** (order - 1.0)
    by_order = steep * x * np.log(x) if x > 0.0 else 0.0
    return chain(size, steep * x, order * steep) + chain(n, 0.0, by_order)


@jit
def pinch_of(room, e):
    """zeta_1, zeta_2 and q z_u: depth, width and place of the pinch."""
    zeta_1 = room[LAW + SLIP] * (1.0 - exponential(room[LAW + SLIP_RATE] * e * -1.0))
    zeta_2 = (room[LAW + PSI] + room[LAW + D_PSI] * e) * (room[LAW + SEVERITY] + zeta_1)
    total, order = (
        (1.0 + room[LAW + D_NU] * e) * (room[LAW + BETA] + room[LAW + GAMMA]),
        room[LAW + SHARPNESS],
    )
    base, n = scalar(total), scalar(order)
    value = base ** (-1.0 / n)
    z_u = chain(total, value, -value / (n * base)) + chain(order, 0.0, value * np.log(base) / (n * n))
    return zeta_1, zeta_2, room[LAW + Q] * z_u


@jit
def rate(room, w, e, sign):
    """dw/dx on the side of w that `sign` names."""
    nu, eta = 1.0 + room[LAW + D_NU] * e, 1.0 + room[LAW + D_ETA] * e
    c = room[LAW + GAMMA] + room[LAW + BETA] * sign
    value = (1.0 - nu * power(w * sign, room[LAW + SHARPNESS]) * c) * inverse(eta)
    if scalar(room[LAW + SLIP]) == 0.0 and registers(room) == 1:  # there may be derivatives by what is zero
        return value
    zeta_1, zeta_2, place = pinch_of(room, e)
    u = (w - place) * inverse(zeta_2)
    return value * (1.0 - zeta_1 * exponential(u * u * -1.0))


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


@jit
def take_step(room, step, by_w):
    """Write the result of a step in x or, if `by_w`, in w; return its error."""
    nil, sign = 0.0 * step, -1.0 if scalar(room[W]) < 0.0 else 1.0
    for s in range(LAST + 1):
        for i in range(3):
            total = nil
            for b in range(s):
                total = total + room[STAGE + 3 * b + i] * STAGES[s, b]
            room[NEW + i] = room[i] + step * total
        w, here = room[NEW + W], STAGE + 3 * s
        value = rate(room, w, room[NEW + E], sign)
        room[here + W], room[here + E], room[here + LEFT] = value, w, nil - 1.0
        if by_w:
            value = inverse(value)
            room[here + W], room[here + E], room[here + LEFT] = nil + 1.0, w * value, value * -1.0
    return step_error(room, scalar(step), LEFT if by_w else W)


@jit
def step_error(room, step, first):
    """Largest error of a step: of w, or of the way that is left, and of e beside 1 + e."""
    of_first, of_energy = 0.0, 0.0
    for s in range(LAST + 1):
        of_first += ERROR[s] * scalar(room[STAGE + 3 * s + first])
        of_energy += ERROR[s] * scalar(room[STAGE + 3 * s + E])
    return abs(step) * max(abs(of_first), abs(of_energy) / (1.0 + abs(scalar(room[E]))))


@jit
def longest(room):
    """A step that cannot miss the pinch: half its width, or half the distance to it.

    Nor, where derivatives are wanted, the singularity of |w|^n log|w| at zero, the derivative by n.
    """
    near, w = LONGEST_STEP, scalar(room[W])
    if registers(room) > 1 and scalar(room[LAW + SHARPNESS]) < SMOOTH:
        near = max(NEAR_ZERO, 0.5 * abs(w))
    if scalar(room[LAW + SLIP]) == 0.0:
        return near
    _, zeta_2, place = pinch_of(room, room[E])
    return min(near, LONGEST_STEP, max(0.5 * scalar(zeta_2), 0.5 * abs(w - scalar(place))))


@jit
def go(room, suggested):
    """Take a specimen along a straight path, `LEFT` long; return a step for the next one, or NaN."""
    for _ in range(MOST_STEPS):
        left = scalar(room[LEFT])
        if left <= 0.0:
            return suggested
        part = min(suggested, longest(room)) / left
        part = 1.0 if part >= 1.0 else min(part, 0.5)
        error = take_step(room, room[LEFT] * part, False)
        factor = 0.9 * (TOLERANCE / max(error, 1e-5 * TOLERANCE)) ** 0.2
        if not error <= TOLERANCE:
            if not error < np.inf:
                return np.nan
            suggested = max(factor, 0.1) * part * left
            continue
        longer = min(factor, 5.0) * part * left
        suggested = min(max(longer, suggested) if part == 1.0 else longer, LONGEST_STEP)
        if scalar(room[W]) < 0.0 < scalar(room[NEW + W]):
            to_zero(room, part)
        elif part == 1.0:
            room[NEW + LEFT] = 0.0 * room[LEFT]
        for i in range(3):
            room[i] = room[NEW + i]
    return np.nan


@jit
def to_zero(room, part):
    """Step to w = 0, or, if that is too far for one step, on the way to it."""
    into, nil = 1.0, 0.0 * room[W]
    while into > 1e-3:
        if take_step(room, room[W] * -into, True) <= TOLERANCE:
            break
        into *= 0.5
    if scalar(room[NEW + LEFT]) < 0.0:  # by less than the errors, the way ends before
        take_step(room, room[LEFT] * part, False)
        if part == 1.0:
            room[NEW + LEFT] = nil
    elif into == 1.0:
        room[NEW + W] = nil


@jit
def march(like, law, excitation, force, gradient):
    """Write the force (u,) [N] at the output samples, and its derivatives by the parameters.

    Parameters
    ----------
    like : number
        Of the kind that is computed with: with slopes, or without.
    law : array (14,)
        In the order of `NAMES`.
    excitation : Excitation
        The displacement [m] as its input. The specimen is untouched at the displacement zero.
    force, gradient : array (u,), (14, u) or (0, u)
        Written; NaN where the parameters describe no specimen, or the integration fails.
    """
    displacement, _, substeps, stride, _ = excitation
    one, size = lanes(like), lanes(like) * registers(like)
    memory = new_numbers((OUT + 1) * size)
    room = view(memory, like)
    for i in range(N_PARAMETERS):
        room[LAW + i] = 0.0 * like + law[i]
        if registers(like) > 1:
            memory[(LAW + i) * size + one + i] = 1.0
    k, reach, ratio = room[LAW + STIFFNESS], room[LAW + REACH], room[LAW + RATIO]
    suggested = FIRST_STEP if is_specimen(law) else np.nan
    before, direction = 0.0, 1.0
    for fine in range((displacement.size - 1) * substeps + 1):
        d = ground_at(displacement, fine, substeps)
        if d != before and suggested == suggested:
            if (d - before) * direction < 0.0:
                direction = -direction
                room[W] = room[W] * -1.0
            room[LEFT] = inverse(reach) * abs(d - before)
            suggested = go(room, suggested)
            before = d
        if fine % stride == 0:
            room[OUT] = k * (ratio * d + (1.0 - ratio) * reach * room[W] * direction)
            force[fine // stride] = memory[OUT * size]
            for i in range(gradient.shape[0]):
                gradient[i, fine // stride] = memory[OUT * size + one + i]
    if not np.isfinite(suggested):
        force[:] = np.nan
        gradient[:] = np.nan


@jit
def march_values(law, excitation, force, gradient):
    """Write the force alone."""
    march(0.0, law, excitation, force, gradient)


@jit
def march_slopes(law, excitation, force, gradient):
    """Write the force and its derivatives."""
    march(with_slopes(0.0), law, excitation, force, gradient)


def numbers(array) -> np.ndarray:
    """A copy as float64, in C order: one compiled kernel serves all arrays."""
    return np.array(array, dtype=np.float64, order="C")


def forces(law, excitation, *, with_gradient=False) -> tuple[np.ndarray, np.ndarray]:
    """Force (u,) [N] of one specimen, and its derivatives (14, u), or (0, u)."""
    law, displacement = numbers(law), numbers(excitation.acceleration)
    if law.shape != (N_PARAMETERS,):
        raise ValueError(f"`law` must have the {N_PARAMETERS} parameters of a specimen, got {law.shape}.")
    given = Excitation(displacement, *map(int, (1, excitation.substeps, excitation.stride)))
    total = n_outputs(displacement.size, given.substeps, given.stride)
    force, gradient = np.empty(total), np.empty((N_PARAMETERS if with_gradient else 0, total))
    (march_slopes if with_gradient else march_values)(law, given, force, gradient)
    return force, gradient


def at_sensors(wanted, history) -> np.ndarray:
    """The only history (..., u) as those of the sensors asked for, (..., s, u)."""
    return np.repeat(history[..., None, :], np.size(wanted.sensors), axis=-2)


def response(parameters, excitation, wanted):
    """Force (s, u)."""
    return at_sensors(wanted, forces(parameters.law, excitation)[0])


def misfit(parameters, excitation, wanted, observed):
    """Statistics (s, 4)."""
    return statistics(response(parameters, excitation, wanted), checked(observed, excitation, wanted))


def population_misfit(parameters, excitation, wanted, observed):
    """Statistics (p, s, 4)."""
    return np.stack([misfit(SpecimenParameters(row), excitation, wanted, observed) for row in parameters.law])


def checked(history, excitation, wanted) -> np.ndarray:
    """Data or a cotangent, if it has the shape of the response."""
    size = np.shape(excitation.acceleration)[-1]
    expected = np.size(wanted.sensors), n_outputs(size, int(excitation.substeps), int(excitation.stride))
    if np.shape(history) != expected:
        raise ValueError(
            "`observed`, or the cotangent, must have the shape (sensor, time) of the response, "
            f"{expected}, got {np.shape(history)}."
        )
    return numbers(history)


def response_gradient(parameters, excitation, wanted, cotangent):
    """Gradient of sum_jk W_jk y_jk."""
    _, gradient = forces(parameters.law, excitation, with_gradient=True)
    return SpecimenParameters(gradient @ checked(cotangent, excitation, wanted).sum(axis=0))


def misfit_gradient(parameters, excitation, wanted, observed, weights):
    """Gradient of sum_jq c_jq times the statistics."""
    force, gradient = forces(parameters.law, excitation, with_gradient=True)
    cotangent = at_sensors(wanted, force)
    weigh_history(cotangent, checked(observed, excitation, wanted), numbers(weights))
    return SpecimenParameters(gradient @ cotangent.sum(axis=0))


def population_gradient(parameters, excitation, wanted, observed, weights):
    """Gradients (p, 14), or their sum (1, 14) where all particles share the parameters."""
    law, rows = parameters.law, []
    for k, own in enumerate(weights):
        specimen = SpecimenParameters(law[k % len(law)])
        rows.append(misfit_gradient(specimen, excitation, wanted, observed, own).law)
    return SpecimenParameters(np.stack(rows) if len(law) > 1 else np.sum(rows, axis=0, keepdims=True))


def response_tangent(parameters, excitation, wanted, directions):
    """Derivative (s, u) along a direction."""
    _, gradient = forces(parameters.law, excitation, with_gradient=True)
    return at_sensors(wanted, numbers(directions[0]) @ gradient)


def discrepancy_tangent(parameters, excitation, wanted, observed, directions):
    """Derivative (s,) of the mean squares along a direction."""
    force, gradient = forces(parameters.law, excitation, with_gradient=True)
    observed = checked(observed, excitation, wanted)
    difference = measured_difference(at_sensors(wanted, force), observed)
    return 2.0 * (difference * (numbers(directions[0]) @ gradient)).mean(axis=1)


KERNELS = {
    "response": response,
    "discrepancy": lambda *given: misfit(*given)[:, 0],
    "misfit": misfit,
    "response_gradient": response_gradient,
    "misfit_gradient": misfit_gradient,
    "response_tangent": response_tangent,
    "discrepancy_tangent": discrepancy_tangent,
    "population_discrepancy": lambda *given: population_misfit(*given)[..., 0],
    "population_misfit": population_misfit,
    "population_gradient": population_gradient,
}
