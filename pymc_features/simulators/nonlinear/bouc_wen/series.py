"""Taylor series of Bouc-Wen springs (`law.py`) with n = 1 and 2, and their reverse."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit, unrolled
from pymc_features.simulators.numbers.compiled_numbers import where_less
from pymc_features.simulators.numbers.vectors import splat
from pymc_features.simulators.taylor.adjoint.series import Adjoint, add_constant, correlation
from pymc_features.simulators.taylor.series import (
    RATE,
    Group,
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

# z' = d' (1 - w) / d_y with w = loss |z|^n = a z + b z^2
ORDER = 7
LOSSES = 2  # series of w
ELASTIC, HYSTERETIC, PER_YIELD, LOADING, UNLOADING, POWER, BY_Z, BY_SQUARE, YIELD = range(9)


def constants(stiffness, values):
    """a k, (1 - a) k d_y, 1 / d_y, the losses of both branches, and n."""
    d_y, ratio, sharpness, beta, gamma = values
    elastic, hysteretic = ratio * stiffness, (1.0 - ratio) * stiffness * d_y
    return [elastic, hysteretic, 1.0 / d_y, gamma + beta, gamma - beta, sharpness]


def loss_of(spring, loading):
    """gamma + b beta of the branch."""
    losses = constant_of(spring, LOADING), constant_of(spring, UNLOADING)
    return where_less(splat(0.0), loading, losses[0], losses[1])


def advance(spring, k, drift, rate, losses, factor=1.0):
    """z_k+1 = (d'_k - (d' w)_k) / (k + 1) / d_y, with w = `factor` times `losses`; return the force."""
    write_coefficient(spring, RATE, k, rate)
    write_coefficient(spring, LOSSES, k, losses)
    change = constant_of(spring, PER_YIELD) * (rate - factor * product(spring, RATE, LOSSES, k))
    write_coefficient(spring, Z, k + 1, change * splat(1.0 / (k + 1)))
    return constant_of(spring, ELASTIC) * drift + constant_of(spring, HYSTERETIC) * coefficient(spring, Z, k)


def tangents(spring, losses):
    """By drift, with z following; z by drift; and by z."""
    by_drift, by_z = constant_of(spring, PER_YIELD) * (1.0 - losses), constant_of(spring, HYSTERETIC)
    return constant_of(spring, ELASTIC) + by_z * by_drift, by_drift, by_z


loss_of, advance, tangents = jit(loss_of), jit(advance), jit(tangents)


def constants_of_squares(stiffness, values):
    """Constants of the law, a and b of a branch, and d_y."""
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
def add_loss(bars, loading, loss):
    """Add to the bar of the loss of a branch."""
    zero = splat(0.0)
    add_constant(bars, LOADING, where_less(zero, loading, loss, zero))
    add_constant(bars, UNLOADING, where_less(zero, loading, zero, loss))


@jit
def add_losses(spring, bars, loading, sign, by_z, by_square):
    """Add to the bar of the loss of a branch, from those of a and b."""
    is_linear = 2.0 - constant_of(spring, POWER)
    add_loss(bars, loading, is_linear * (sign * by_z) + (1.0 - is_linear) * by_square)


@unrolled
def add_stiffnesses(spring, bars, drift, forces, d_y, order):
    """Add to the bars of the first three constants: dL/d(1/d_y) = d_y sum_k zbar_k z_k, k > 0.

    `forces` is the series of their bars, `d_y` the yield displacement, and `order` that of the polynomials.
    """
    elastic = hysteretic = per_yield = splat(0.0)
    for k in range(order):
        per_yield = per_yield + (k + 1.0) * coefficient(bars, Z, k + 1) * coefficient(spring, Z, k + 1)
        if drift is not None:
            force = coefficient(bars, forces, k)
            hysteretic = hysteretic + force * coefficient(spring, Z, k)
            if k > 0:
                elastic = elastic + (1.0 / k) * force * coefficient(spring, RATE, k - 1)
            else:
                elastic = elastic + force * drift
    add_constant(bars, PER_YIELD, d_y * per_yield)
    if drift is not None:
        add_constant(bars, ELASTIC, elastic)
        add_constant(bars, HYSTERETIC, hysteretic)


@jit
def add_tangents(spring, bars, net, of_tangents):
    """Add to the same bars from those of df/dd = a k + (1 - a) k d_y dz/dd; return the bar of w.

    dz/dd = (1 - w) / d_y, and `net` is 1 - w.
    """
    of_drift, z_of_drift, of_z = of_tangents
    per_yield, total = constant_of(spring, PER_YIELD), z_of_drift + constant_of(spring, HYSTERETIC) * of_drift
    add_constant(bars, ELASTIC, of_drift)
    add_constant(bars, HYSTERETIC, of_drift * per_yield * net + of_z)
    add_constant(bars, PER_YIELD, net * total)
    return per_yield * (0.0 - total)


def reverse_sums(spring, bars, drift, loading, sign):
    """Bars of the constants from those of the series."""
    by_z = by_square = splat(0.0)
    for k in range(ORDER):
        z = coefficient(spring, Z, k)
        by_z = by_z + coefficient(bars, LOSSES_BAR, k) * z
        by_square = by_square + coefficient(bars, SQUARES_BAR, k) * z
    add_stiffnesses(spring, bars, drift, FORCES, constant_of(spring, YIELD), ORDER)
    add_losses(spring, bars, loading, sign, by_z, by_square)


def reverse_tangent(spring, bars, z, of_tangents, loading, sign):
    """By a and b, and by z."""
    a, b = constant_of(spring, BY_Z), constant_of(spring, BY_SQUARE)
    losses = add_tangents(spring, bars, 1.0 - z * (a + b * z), of_tangents)
    add_losses(spring, bars, loading, sign, losses * z, losses * z * z)
    return losses * (a + 2.0 * (b * z))


def in_range(values):
    """Whether all but n lie in their ranges."""
    d_y, ratio, _, beta, gamma = values
    springs = (d_y > 0.0) & (d_y < np.inf) & (ratio >= 0.0) & (ratio <= 1.0)
    loops = (beta > 0.0) & (beta < np.inf) & (gamma >= 0.0) & (gamma <= beta)
    return springs & loops


def serves(values):
    """Whether n is 1 or 2, and the other parameters lie in their ranges."""
    return in_range(values) & np.isin(values[SHARPNESS], (1.0, 2.0))


class OneOrTwo(Group):
    """Chains in lanes whose springs have n = 1 or 2."""


SQUARES = Series(
    order=ORDER,
    tolerance=6e-8,
    n_series=3,
    n_constants=9,
    serves=serves,
    constants=constants_of_squares,
    expand=expand,
    branch=branch,
    tangent=tangent,
    adjoint=Adjoint(FORCES, reverse, reverse_sums, reverse_tangent, fixed=((SHARPNESS, (1.0, 2.0)),)),
)
