"""Taylor series of Bouc-Wen springs (`law.py`) with any n, and their reverse.

|z|^n is a polynomial over the range of each step (`taylor/powers.py`), w = loss sum_k c_k y^k, y = |z| - c.
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.nonlinear.bouc_wen.series import (
    ELASTIC,
    HYSTERETIC,
    LOSSES,
    LOSSES_BAR,
    PER_YIELD,
    POWER,
    SHARPNESS,
    add_loss,
    add_stiffnesses,
    add_tangents,
    advance,
    constants,
    in_range,
    loss_of,
    tangents,
)
from pymc_features.simulators.numbers.compiled_numbers import where_less
from pymc_features.simulators.numbers.vectors import splat
from pymc_features.simulators.taylor.adjoint.series import Adjoint, add_power, correlation
from pymc_features.simulators.taylor.powers import (
    ACROSS,
    COEFFICIENTS,
    DEGREE,
    FROM_ZERO,
    HALF,
    HOLD,
    LEFT,
    MIDDLE,
    N_CONSTANTS,
    WHOLE,
    choose_polynomial,
    power_constants,
    shapes_of,
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

ORDER = 6
SHARPEST = 6.0  # n of springs that take Taylor steps
DISTANCES, REST = LOSSES + 1, LOSSES + 2  # series of y^2, and of c_2 + c_3 y + c_4 y^2
LOSS, SIGN, POWER_OF_Z = range(POWER, POWER + 3)  # constants; the last of them begins those of `powers.py`


def constants_any(stiffness, values):
    """Constants of the law, of a branch, and of the power."""
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
    losses = constant_of(spring, c) + constant_of(spring, c + 1) * y + squared * rest
    write_coefficient(spring, DISTANCES, 0, squared)
    write_coefficient(spring, REST, 0, rest)
    advance(spring, 0, rate, rates[0], losses, loss)


def expand_any(spring, k, drift, rate):
    """P_k = c_1 y_k + (y^2 (c_2 + c_3 y + c_4 y^2))_k, and w = loss P."""
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
    return advance(spring, k, drift, rate, losses, constant_of(spring, LOSS))


def tangent_any(spring, z):
    """By the polynomial of the step."""
    c = POWER_OF_Z + COEFFICIENTS
    y = constant_of(spring, SIGN) * z - constant_of(spring, POWER_OF_Z + MIDDLE)
    losses = constant_of(spring, c + DEGREE)
    for k in range(DEGREE - 1, -1, -1):
        losses = losses * y + constant_of(spring, c + k)
    return tangents(spring, constant_of(spring, LOSS) * losses)


def serves_any(values):
    """Whether n is at most `SHARPEST`, and the parameters lie in their ranges."""
    return in_range(values) & (values[SHARPNESS] >= 1.0) & (values[SHARPNESS] <= SHARPEST)


SLOPES, TILTS, FORCES = range(LOSSES_BAR + 1, LOSSES_BAR + 4)  # series of bars, and of P' and (P' - c_1) / y


def constants_with_bars(stiffness, values):
    """Constants that a gradient has bars of, from `constants_any` as far as the last of them."""
    *usual, sharpness = constants(stiffness, values)
    between = [0.0 * sharpness] * (FROM_ZERO - 1)
    return [*usual, 0.0 * sharpness, 0.0 * sharpness, sharpness, *between, *shapes_of(sharpness)]


def reverse_any(spring, bars, k, force):
    """z' = d' (1 - loss P) / d_y and P' = c_1 + y (2 c_2 + 3 c_3 y + 4 c_4 y^2), transposed.

    Order k needs P' up to order 5 - k, the last of which is found here.
    """
    loss, per_yield = constant_of(spring, LOSS), constant_of(spring, PER_YIELD)
    m, c, sign = ORDER - 1 - k, POWER_OF_Z + COEFFICIENTS, constant_of(spring, SIGN)
    y, first = sign * coefficient(spring, Z, m), sign * coefficient(spring, Z, 0)
    first = first - constant_of(spring, POWER_OF_Z + MIDDLE)
    tilt = 4.0 * (constant_of(spring, c + 4) * coefficient(spring, DISTANCES, m))
    tilt = tilt + 3.0 * (constant_of(spring, c + 3) * (first if m == 0 else y))
    if m == 0:
        tilt = tilt + 2.0 * constant_of(spring, c + 2)
    write_coefficient(bars, TILTS, m, tilt)
    slope = splat(0.0)
    for j in range(1, m + 1):
        slope = slope + coefficient(spring, Z, j) * coefficient(bars, TILTS, m - j)
    slope = sign * slope + first * tilt
    if m == 0:
        slope = slope + constant_of(spring, c + 1)
    write_coefficient(bars, SLOPES, m, slope)
    net = coefficient(bars, Z, k + 1) - loss * correlation(bars, Z, spring, LOSSES, k, 1)
    losses = per_yield * (0.0 - correlation(bars, Z, spring, RATE, k, 1))
    write_coefficient(bars, LOSSES_BAR, k, losses)
    of_z = (loss * sign) * correlation(bars, LOSSES_BAR, bars, SLOPES, k)
    return (
        constant_of(spring, ELASTIC) * force,
        per_yield * net,
        of_z + constant_of(spring, HYSTERETIC) * force,
    )


def reverse_sums_any(spring, bars, drift, loading, sign):
    """Bars of the constants from those of the series; that of c_k is loss sum_j wbar_j (y^k)_j."""
    by_loss = by_second = by_third = by_fourth = splat(0.0)
    by_first, middle = splat(0.0), constant_of(spring, POWER_OF_Z + MIDDLE)
    for k in range(ORDER):
        losses, z = coefficient(bars, LOSSES_BAR, k), sign * coefficient(spring, Z, k)
        y = z - middle if k == 0 else z
        by_loss = by_loss + losses * coefficient(spring, LOSSES, k)
        by_first = by_first + losses * y
        by_second = by_second + losses * coefficient(spring, DISTANCES, k)
        third = sign * product(spring, Z, DISTANCES, k) - middle * coefficient(spring, DISTANCES, k)
        by_third = by_third + losses * third
        by_fourth = by_fourth + losses * square(spring, DISTANCES, k)
    loss = constant_of(spring, LOSS)
    of_all = coefficient(bars, LOSSES_BAR, 0), by_first, by_second, by_third, by_fourth
    shape = FROM_ZERO if drift is None else ACROSS
    add_power(spring, bars, POWER_OF_Z, loss, of_all, shape)
    add_loss(bars, loading, by_loss)
    add_stiffnesses(spring, bars, drift, FORCES, 1.0 / constant_of(spring, PER_YIELD), ORDER)


def reverse_tangent_any(spring, bars, z, of_tangents, loading, sign):
    """By the polynomial of the step."""
    c, zero = POWER_OF_Z + COEFFICIENTS, splat(0.0)
    y = sign * z - constant_of(spring, POWER_OF_Z + MIDDLE)
    value, slope = constant_of(spring, c + DEGREE), zero
    for k in range(DEGREE - 1, -1, -1):
        slope = slope * y + value
        value = value * y + constant_of(spring, c + k)
    loss = constant_of(spring, LOSS)
    losses = add_tangents(spring, bars, 1.0 - loss * value, of_tangents)
    y_2 = y * y
    of_all = losses, losses * y, losses * y_2, losses * (y_2 * y), losses * (y_2 * y_2)
    add_power(spring, bars, POWER_OF_Z, loss, of_all, ACROSS)
    add_loss(bars, loading, losses * value)
    return (loss * sign) * (losses * slope)


class AnySharpness(Group):
    """Chains in lanes whose springs have any n in the range of `serves_any`."""


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
    adjoint=Adjoint(FORCES, reverse_any, reverse_sums_any, reverse_tangent_any, constants_with_bars),
)
