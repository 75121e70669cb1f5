"""Polynomials in place of |z|^n with any real n, over the range of z in one step.

A power has no series about zero, and close to zero the series about z is of no use over a step. Here |z|^n
becomes a quartic in y = |z| - c over the range that z is expected to take, from a to b,

    |z|^n = c^n sum_k q_k (y / c)^k.

Where a is above b / 5, c is the middle of the range, and the q_k are those of the binomial series whose
powers five to seven have been replaced by Chebyshev's best polynomials on the range (economisation).

Nearer to zero there are two polynomials more, whose q_k depend on n alone: a quartic from zero, with c =
b / 2, and a rougher quadratic across it. `ranges.py` chooses among them.

Ranges of |z| for polynomials in place of |z|^n (`powers.py`), from what z is expected to do.

Near to zero, and where the range is so wide that z would be wrong by more than some `ERROR`, the spring is
treated as one with kinks (`kinks.py`): its z is expanded anew, piece by piece, each over a range for which a
quartic is good. The motion of the chain goes by a polynomial that is rougher and does not depart far beyond
the range: near zero the quadratic.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import larger, magnitude, square_root, where_less
from pymc_features.simulators.numbers.vector_math import exponential, logarithm
from pymc_features.simulators.numbers.vectors import any_less, splat
from pymc_features.simulators.taylor.series import LONG, constant_of, write_constant

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


NEAR = 5.0  # end over beginning of a range that is near zero
BEYOND = 1.1  # reach of the quartic from zero, beside the range expected
SMALLEST = 1e-3, 1e-7  # end of a range in a march, where the change of z is a guess, and in a batch
WIDEST = 0.66  # half of a range over its middle


class Expected(NamedTuple):
    """|z| at first, its end expected, and the parts of its change by the first drift rate and by the rest."""

    size: object
    end: object
    first: object
    second: object


@jit
def choose_for_march(spring, first, size, end):
    """Write the polynomial of a whole step, along which |z| goes from `size` to `end`, about."""
    zero, smallest = splat(0.0), splat(SMALLEST[0])
    low, high = where_less(size, end, size, end), larger(size, end)
    zone = larger(high - NEAR * low, smallest - high)
    span, total = high - low, high + low
    excess = constant_of(spring, first + NARROWNESS) * high * (span * span) - total * total
    hold = where_less(zero, larger(excess, zone), zero, splat(LONG))
    write_constant(spring, first + HOLD, hold)
    farthest = larger(larger(high, zero - low), smallest)
    middle = where_less(zero, zone, zero, 0.5 * total)
    extent = where_less(zero, zone, farthest, middle)
    write_constant(spring, first + MIDDLE, middle)
    half = larger(0.5 * span, 0.1 * extent)
    write_constant(spring, first + HALF, OUTSIDE * where_less(zero, zone, extent, half))
    powers = write_polynomial(spring, first, where_less(zero, zone, zero, low), high, extent)
    if any_less(zero, zone):
        replace_polynomial(spring, first, zone, powers, ACROSS, 3)


@jit
def excess_of(spring, first, expected):
    """Positive where a range expected is too wide for one piece."""
    size, end = expected.size, expected.end
    low, high = where_less(size, end, size, end), larger(size, end)
    is_near, span, total = high - NEAR * low, high - low, high + low
    excess = constant_of(spring, first + NARROWNESS) * high * (span * span) - total * total
    excess = where_less(splat(0.0), is_near, high - constant_of(spring, first + NEAR_END), excess)
    return where_less(low, splat(0.0), splat(1.0), excess)


@jit
def good_end(spring, first, expected):
    """Place where to end the first piece of a range."""
    size, end = expected.size, expected.end
    near_end, narrowness = constant_of(spring, first + NEAR_END), constant_of(spring, first + NARROWNESS)
    r = square_root(1.0 / (narrowness * (2.0 * magnitude(size)) + 1e-300))
    r = where_less(r, splat(WIDEST), r, splat(WIDEST))
    ratio = (1.0 + r) / (1.0 - r)
    up = where_less(NEAR * size, near_end, near_end, size * ratio)
    up = where_less(up, end, up, end)
    down = where_less(near_end, size, size / ratio, -0.5 * magnitude(size) - SMALLEST[1])
    return where_less(size, end, up, larger(down, end))


@jit
def time_of(expected, target):
    """When |z| is expected to have come to a target, as a share of the time to the end of the step."""
    s, q = expected.first, expected.second
    sign = where_less(splat(0.0), s + q, splat(1.0), splat(-1.0))
    change, s, q = sign * (target - expected.size), sign * s, sign * q
    root = square_root(larger(s * s + 4.0 * (q * change), splat(0.0)))
    share = 2.0 * change / (s + root + 1e-300)
    return where_less(share, splat(1.0), larger(share, splat(1e-3)), splat(1.0))


@jit
def choose_for_piece(spring, first, expected):
    """Write the polynomial of the next piece, and until when it holds."""
    zero = splat(0.0)
    size, end, hold = expected.size, expected.end, splat(LONG)
    excess = excess_of(spring, first, expected)
    if any_less(zero, excess):
        good = good_end(spring, first, expected)
        time = constant_of(spring, first + LEFT) * time_of(expected, good)
        end, hold = where_less(zero, excess, good, end), where_less(zero, excess, time, hold)
    write_constant(spring, first + HOLD, hold)
    low, high = where_less(size, end, size, end), larger(size, end)
    is_near, high = high - NEAR * low, larger(high, splat(SMALLEST[1]))
    middle = where_less(zero, is_near, (0.5 * BEYOND) * high, 0.5 * (low + high))
    write_constant(spring, first + MIDDLE, middle)
    powers = write_polynomial(spring, first, low, high, middle)
    replace_polynomial(spring, first, is_near, powers, FROM_ZERO, DEGREE + 1)


@jit
def choose_polynomial(spring, first, size, slope, rates):
    """Write the polynomial of a step, with the drift rate, its slope, and its integral over the step.

    |z| is `size` at first and changes by `slope` with the drift, about. In a march the integral is not known.
    """
    zero, left = splat(0.0), constant_of(spring, first + LEFT)
    rate, rate_slope, drift = rates
    is_march = any_less(zero, constant_of(spring, first + WHOLE))
    if is_march:
        drift = rate + 0.5 * rate_slope
    s, change = slope * (rate * left), slope * drift
    if is_march:
        turns = 0.5 * magnitude(s) - magnitude(change)  # positive: z comes back
        change = where_less(zero, turns, 0.5 * s, change)
        choose_for_march(spring, first, size, size + change)
    else:  # where z comes back, the piece ends at the turn, with half the time: s t + q t^2
        q = change - s
        turns = 0.0 - (s + 2.0 * q) * s
        change = where_less(zero, turns, 0.25 * s * s / (0.0 - q), change)
        choose_for_piece(spring, first, Expected(size, size + change, s, q))
