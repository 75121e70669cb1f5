"""Taylor series of Bouc-Wen springs (`law.py`), and the reverse of those for n = 1 and 2."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import splat, where_less
from pymc_features.simulators.taylor.adjoint.series import Adjoint, add_constant, correlation
from pymc_features.simulators.taylor.powers import (
    COEFFICIENTS,
    DEGREE,
    HALF,
    HOLD,
    LEFT,
    MIDDLE,
    N_CONSTANTS,
    WHOLE,
    choose_polynomial,
    power_constants,
)
from pymc_features.simulators.taylor.series import (
    RATE,
    Group,
    Pieces,
    Series,
    Z,
    coefficient,
    constant_of,
    product,
    square,
    write_coefficient,
    write_constant,
)

YIELD_DISPLACEMENT, RATIO, SHARPNESS, BETA, GAMMA = range(5)
SHARPEST = 6.0  # n of springs that take Taylor steps

# Taylor series, for n = 1 and 2: z' = d' (1 - w) / d_y with w = loss |z|^n = a z + b z^2
ORDER = 6
LOSSES = 2  # series of w
ELASTIC, HYSTERETIC, PER_YIELD, LOADING, UNLOADING, POWER, BY_Z, BY_SQUARE, YIELD = range(9)


def constants(stiffness, values):
    """a k, (1 - a) k d_y, 1 / d_y, the losses of both branches, and n."""
    reach, ratio, sharpness, beta, gamma = values
    elastic, hysteretic = ratio * stiffness, (1.0 - ratio) * stiffness * reach
    return [elastic, hysteretic, 1.0 / reach, gamma + beta, gamma - beta, sharpness]


def loss_of(spring, loading):
    """gamma + b beta of the branch."""
    losses = constant_of(spring, LOADING), constant_of(spring, UNLOADING)
    return where_less(splat(0.0), loading, losses[0], losses[1])


def advance(spring, k, drift, rate, losses):
    """z_k+1 = (d'_k - (d' w)_k) / (k + 1) / d_y; return the force."""
    write_coefficient(spring, RATE, k, rate)
    write_coefficient(spring, LOSSES, k, losses)
    change = constant_of(spring, PER_YIELD) * (rate - product(spring, RATE, LOSSES, k))
    write_coefficient(spring, Z, k + 1, change * splat(1.0 / (k + 1)))
    return constant_of(spring, ELASTIC) * drift + constant_of(spring, HYSTERETIC) * coefficient(spring, Z, k)


def tangents(spring, losses):
    """By drift, with z following; z by drift; and by z."""
    by_drift, by_z = constant_of(spring, PER_YIELD) * (1.0 - losses), constant_of(spring, HYSTERETIC)
    return constant_of(spring, ELASTIC) + by_z * by_drift, by_drift, by_z


loss_of, advance, tangents = jit(loss_of), jit(advance), jit(tangents)


def constants_of_squares(stiffness, values):
    """Those above, a and b of a branch, and d_y."""
    usual = constants(stiffness, values)
    return [*usual, 0.0 * stiffness, 0.0 * stiffness, values[YIELD_DISPLACEMENT]]


def branch(spring, loading, sign):
    """a and b of a branch."""
    loss, is_linear = loss_of(spring, loading), 2.0 - constant_of(spring, POWER)
    write_constant(spring, BY_Z, is_linear * loss * sign)
    write_constant(spring, BY_SQUARE, (1.0 - is_linear) * loss)


def expand(spring, k, drift, rate):
    """w_k = a z_k + b (z^2)_k."""
    z = coefficient(spring, Z, k)
    losses = constant_of(spring, BY_Z) * z + constant_of(spring, BY_SQUARE) * square(spring, Z, k)
    return advance(spring, k, drift, rate, losses)


def tangent(spring, z):
    """With w = a z + b z^2."""
    return tangents(spring, z * (constant_of(spring, BY_Z) + constant_of(spring, BY_SQUARE) * z))


LOSSES_BAR, SQUARES_BAR, FORCES = 2, 3, 4  # series of bars: of w_k and of (z^2)_k / b, then of the force


def reverse(spring, bars, k, force):
    """z' = d' (1 - w) / d_y and w = a z + b z^2, transposed."""
    change, per_yield = coefficient(bars, Z, k + 1), constant_of(spring, PER_YIELD)
    net = change - correlation(bars, Z, spring, LOSSES, k, 1)
    losses = per_yield * (0.0 - correlation(bars, Z, spring, RATE, k, 1))
    write_coefficient(bars, LOSSES_BAR, k, losses)
    squares = correlation(bars, LOSSES_BAR, spring, Z, k)
    write_coefficient(bars, SQUARES_BAR, k, squares)
    of_z = constant_of(spring, BY_Z) * losses + 2.0 * (constant_of(spring, BY_SQUARE) * squares)
    return (
        constant_of(spring, ELASTIC) * force,
        per_yield * net,
        of_z + constant_of(spring, HYSTERETIC) * force,
    )


@jit
def add_losses(spring, bars, loading, sign, by_z, by_square):
    """Add to the bar of the loss of a branch, from those of a and b."""
    zero, is_linear = splat(0.0), 2.0 - constant_of(spring, POWER)
    loss = is_linear * (sign * by_z) + (1.0 - is_linear) * by_square
    add_constant(bars, LOADING, where_less(zero, loading, loss, zero))
    add_constant(bars, UNLOADING, where_less(zero, loading, zero, loss))


def reverse_sums(spring, bars, drift, loading, sign):
    """Bars of the constants from those of the series: dL/d(1/d_y) = d_y sum_k zbar_k z_k, k > 0."""
    elastic = hysteretic = per_yield = by_z = by_square = splat(0.0)
    for k in range(ORDER):
        z = coefficient(spring, Z, k)
        by_z = by_z + coefficient(bars, LOSSES_BAR, k) * z
        by_square = by_square + coefficient(bars, SQUARES_BAR, k) * z
        per_yield = per_yield + (k + 1.0) * coefficient(bars, Z, k + 1) * coefficient(spring, Z, k + 1)
        if drift is not None:
            force = coefficient(bars, FORCES, k)
            hysteretic = hysteretic + force * z
            if k > 0:
                elastic = elastic + (1.0 / k) * force * coefficient(spring, RATE, k - 1)
            else:
                elastic = elastic + force * drift
    add_constant(bars, PER_YIELD, constant_of(spring, YIELD) * per_yield)
    add_losses(spring, bars, loading, sign, by_z, by_square)
    if drift is not None:
        add_constant(bars, ELASTIC, elastic)
        add_constant(bars, HYSTERETIC, hysteretic)


def reverse_tangent(spring, bars, z, of_tangents, loading, sign):
    """df/dd = a k + (1 - a) k d_y dz/dd, with dz/dd = (1 - w) / d_y."""
    of_drift, z_of_drift, of_z = of_tangents
    a, b = constant_of(spring, BY_Z), constant_of(spring, BY_SQUARE)
    net = 1.0 - z * (a + b * z)
    total = z_of_drift + constant_of(spring, HYSTERETIC) * of_drift
    losses = constant_of(spring, PER_YIELD) * (0.0 - total)
    add_constant(bars, ELASTIC, of_drift)
    add_constant(bars, HYSTERETIC, of_drift * constant_of(spring, PER_YIELD) * net + of_z)
    add_constant(bars, PER_YIELD, net * total)
    add_losses(spring, bars, loading, sign, losses * z, losses * z * z)
    return losses * (a + 2.0 * (b * z))


# and for any n: |z|^n by a polynomial over the range of each step (`powers.py`), w = loss sum_k c_k y^k
DISTANCES, REST = LOSSES + 1, LOSSES + 2  # series of y^2, and of c_2 + c_3 y + c_4 y^2
LOSS, SIGN, POWER_OF_Z = range(POWER, POWER + 3)  # constants; the last of them begins those of `powers.py`


def constants_any(stiffness, values):
    """Those above, those of a branch, and those of the power."""
    *usual, sharpness = constants(stiffness, values)
    return [*usual, 0.0 * sharpness, 0.0 * sharpness, *power_constants(sharpness)]


def branch_any(spring, loading, sign):
    """Loss and sign of z."""
    write_constant(spring, LOSS, loss_of(spring, loading))
    write_constant(spring, SIGN, sign)


@jit
def begin_any(spring, rate):
    """Choose the polynomial, and write the coefficients 0 of the losses and 1 of z."""
    left = constant_of(spring, POWER_OF_Z + LEFT)
    drift = splat(0.0)
    for k in range(ORDER, -1, -1):
        drift = (drift + coefficient(spring, RATE, k) * splat(1.0 / (k + 1))) * left
    rates = coefficient(spring, RATE, 0), rate, drift
    sign, loss = constant_of(spring, SIGN), constant_of(spring, LOSS)
    size = sign * coefficient(spring, Z, 0)
    nearly = loss * size * size
    nearly = where_less(nearly, splat(1.0), nearly, splat(1.0))
    slope = sign * (constant_of(spring, PER_YIELD) * (1.0 - nearly))
    choose_polynomial(spring, POWER_OF_Z, size, slope, rates)
    c = POWER_OF_Z + COEFFICIENTS
    y = size - constant_of(spring, POWER_OF_Z + MIDDLE)
    squared = y * y
    rest = constant_of(spring, c + 2) + constant_of(spring, c + 3) * y + constant_of(spring, c + 4) * squared
    losses = loss * (constant_of(spring, c) + constant_of(spring, c + 1) * y + squared * rest)
    write_coefficient(spring, DISTANCES, 0, squared)
    write_coefficient(spring, REST, 0, rest)
    advance(spring, 0, rate, rates[0], losses)


def expand_any(spring, k, drift, rate):
    """w_k = loss (c_1 y_k + (y^2 (c_2 + c_3 y + c_4 y^2))_k)."""
    if k == 0:  # the polynomial is chosen when one more drift rate is known
        write_coefficient(spring, RATE, 0, rate)
        z = coefficient(spring, Z, 0)
        return constant_of(spring, ELASTIC) * drift + constant_of(spring, HYSTERETIC) * z
    if k == 1:
        begin_any(spring, rate)
    c = POWER_OF_Z + COEFFICIENTS
    y = constant_of(spring, SIGN) * coefficient(spring, Z, k)
    squared = square(spring, Z, k) - 2.0 * (constant_of(spring, POWER_OF_Z + MIDDLE) * y)
    rest = constant_of(spring, c + 3) * y + constant_of(spring, c + 4) * squared
    write_coefficient(spring, DISTANCES, k, squared)
    write_coefficient(spring, REST, k, rest)
    losses = constant_of(spring, c + 1) * y + product(spring, DISTANCES, REST, k)
    return advance(spring, k, drift, rate, constant_of(spring, LOSS) * losses)


def tangent_any(spring, z):
    """By the polynomial of the step."""
    c = POWER_OF_Z + COEFFICIENTS
    y = constant_of(spring, SIGN) * z - constant_of(spring, POWER_OF_Z + MIDDLE)
    losses = constant_of(spring, c + DEGREE)
    for k in range(DEGREE - 1, -1, -1):
        losses = losses * y + constant_of(spring, c + k)
    return tangents(spring, constant_of(spring, LOSS) * losses)


def in_range(values):
    """Whether all but n lie in their ranges."""
    reach, ratio, _, beta, gamma = values
    springs = (reach > 0.0) & (reach < np.inf) & (ratio >= 0.0) & (ratio <= 1.0)
    loops = (beta > 0.0) & (beta < np.inf) & (gamma >= 0.0) & (gamma <= beta)
    return springs & loops


def serves(values):
    """Whether n is 1 or 2, and the other parameters lie in their ranges."""
    return in_range(values) & np.isin(values[SHARPNESS], (1.0, 2.0))


def serves_any(values):
    """Whether n is at most `SHARPEST`, and the parameters lie in their ranges."""
    return in_range(values) & (values[SHARPNESS] >= 1.0) & (values[SHARPNESS] <= SHARPEST)


class OneOrTwo(Group):
    """Chains in lanes whose springs have n = 1 or 2."""


class AnySharpness(Group):
    """Chains in lanes whose springs have any n in the range of `serves_any`."""


SQUARES = Series(
    order=ORDER,
    tolerance=4e-7,
    n_series=3,
    n_constants=9,
    serves=serves,
    constants=constants_of_squares,
    expand=expand,
    branch=branch,
    tangent=tangent,
    adjoint=Adjoint(FORCES, reverse, reverse_sums, reverse_tangent, fixed=((SHARPNESS, (1.0, 2.0)),)),
)
POWERS = Series(
    order=ORDER,
    tolerance=1e-7,
    n_series=5,
    n_constants=POWER_OF_Z + N_CONSTANTS,
    serves=serves_any,
    constants=constants_any,
    expand=expand_any,
    branch=branch_any,
    tangent=tangent_any,
    pieces=Pieces(*(POWER_OF_Z + c for c in (LEFT, WHOLE, HOLD, MIDDLE, HALF)), SIGN),
)
SERIES = {OneOrTwo: SQUARES, AnySharpness: POWERS}
