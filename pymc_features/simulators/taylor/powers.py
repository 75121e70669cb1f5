"""Polynomials in place of |z|^n with any real n, over the range of z in one step.

A power has no series about zero, and close to zero the series about z is of no use over a step. Here |z|^n
becomes a quartic in y = |z| - c over the range that z is expected to take, from a to b,

    |z|^n = c^n sum_k q_k (y / c)^k.

Where a is above b / 5, c is the middle of the range, and the q_k are those of the binomial series whose
powers five to seven have been replaced by Chebyshev's best polynomials on the range (economisation).

Nearer to zero there are two polynomials more, whose q_k depend on n alone: a quartic from zero, with c =
b / 2, and a rougher quadratic across it. `ranges.py` chooses among them.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import splat, where_less
from pymc_features.simulators.compiled.vector_math import exponential, logarithm
from pymc_features.simulators.taylor.series import constant_of, write_constant

DEGREE = 4
OUTSIDE = 1.3  # distance from the middle of a range, in halves of it, up to which a polynomial is good
ERROR = 5e-8  # of z at the end of a step, about
NODES = np.cos(np.pi * (np.arange(32) + 0.5) / 32)
POWERS = NODES[:, None] ** np.arange(DEGREE + 1)
FIT = np.linalg.pinv(POWERS)
TAME = 0.1  # weight of |z| < 0, which is no more than continued

# Constants of a spring, from number `first` on: n; the end of a range from zero; how narrow others must be;
# the quartic from zero, the quadratic across it; time to the end of the step; 1 in a march, 0 in a batch of
# kinks; and of a step: until when its polynomial holds, how far from c, c, the square of half the range over
# c, -1 where one of the polynomials above serves, and the coefficients
EXPONENT, NEAR_END, NARROWNESS, FROM_ZERO = range(4)
ACROSS = FROM_ZERO + DEGREE + 1
LEFT, WHOLE, HOLD, HALF, MIDDLE, SQUARE, COEFFICIENTS = range(ACROSS + 3, ACROSS + 10)
N_CONSTANTS = COEFFICIENTS + DEGREE + 1


def shapes_of(n) -> list:
    """Coefficients, (...) each, of the quartic from zero and the quadratic across it."""
    weights = np.where(NODES > 0.0, 1.0, TAME)
    quartic = np.exp(n[..., None] * np.log(1.0 + NODES)) @ FIT.T
    values = weights * np.sign(NODES) * np.exp(n[..., None] * np.log(np.abs(NODES)))
    quadratic = values @ np.linalg.pinv(weights[:, None] * POWERS[:, :3]).T
    return [*np.moveaxis(quartic, -1, 0), *np.moveaxis(quadratic, -1, 0)]


def power_constants(n) -> list:
    """Constants, (...) each, of springs with exponents n (...)."""
    shapes = shapes_of(n)
    quartic = np.stack(shapes[: DEGREE + 1], axis=-1)
    worst = np.abs((1.0 + NODES) ** n[..., None] - quartic @ POWERS.T).max(axis=-1) * 0.5**n
    near_end = np.minimum((6.0 * ERROR / (worst + 1e-15)) ** (1.0 / (n + 1.0)), 1.5)
    fifth = np.abs(np.prod([(n - k) / (k + 1.0) for k in range(DEGREE + 1)], axis=0))
    narrowness = (fifth / (48.0 * ERROR)) ** (1.0 / 3.0)
    one, zero = np.ones_like(n), np.zeros_like(n)
    return [n, near_end, narrowness, *shapes, one, one, *[zero] * (N_CONSTANTS - WHOLE - 1)]


@jit
def economise(binomials, square):
    """Coefficients 0 ... 4 in place of 1 ... 7 for |x| <= r, with `square` = r^2."""
    b1, b2, b3, b4, b5, b6, b7 = binomials
    fourth = square * square
    return (
        b6 * (fourth * square) * 0.03125,
        b1 - fourth * (0.3125 * b5 + 0.4375 * (b7 * square)),
        b2 - fourth * (0.5625 * b6),
        b3 + square * (1.25 * b5 + 1.3125 * (b7 * square)),
        b4 + square * (1.5 * b6),
    )


@jit
def economised(n, square):
    """Coefficients of (1 + x)^n for |x| <= r, with `square` = r^2."""
    b1, b2 = n, n * (n - 1.0) * 0.5
    b3 = b2 * (n - 2.0) * (1.0 / 3.0)
    b4 = b3 * (n - 3.0) * 0.25
    b5 = b4 * (n - 4.0) * 0.2
    b6 = b5 * (n - 5.0) * (1.0 / 6.0)
    b7 = b6 * (n - 6.0) * (1.0 / 7.0)
    q0, q1, q2, q3, q4 = economise((b1, b2, b3, b4, b5, b6, b7), square)
    return 1.0 + q0, q1, q2, q3, q4


@jit
def write_polynomial(spring, first, low, high, extent):
    """Write the economised binomial series for a range; return extent^(n - k), k = 0 ... 4."""
    n = constant_of(spring, first + EXPONENT)
    inverse = 1.0 / extent
    r = 0.5 * (high - low) * inverse
    q0, q1, q2, q3, q4 = economised(n, r * r)
    write_constant(spring, first + SQUARE, r * r)
    p0 = exponential(n * logarithm(extent))
    p1 = p0 * inverse
    p2 = p1 * inverse
    p3 = p2 * inverse
    p4 = p3 * inverse
    write_constant(spring, first + COEFFICIENTS, p0 * q0)
    write_constant(spring, first + COEFFICIENTS + 1, p1 * q1)
    write_constant(spring, first + COEFFICIENTS + 2, p2 * q2)
    write_constant(spring, first + COEFFICIENTS + 3, p3 * q3)
    write_constant(spring, first + COEFFICIENTS + 4, p4 * q4)
    return p0, p1, p2, p3, p4


@jit
def replace_polynomial(spring, first, where, powers, shape, count):
    """Write another polynomial where `where` is positive: `count` coefficients from constant `shape` on."""
    for k in range(DEGREE + 1):
        other = splat(0.0)
        if k < count:
            other = powers[k] * constant_of(spring, first + shape + k)
        at = first + COEFFICIENTS + k
        write_constant(spring, at, where_less(splat(0.0), where, other, constant_of(spring, at)))
    square = constant_of(spring, first + SQUARE)
    write_constant(spring, first + SQUARE, where_less(splat(0.0), where, splat(-1.0), square))
