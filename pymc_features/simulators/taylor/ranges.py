"""Ranges of |z| for polynomials in place of |z|^n (`powers.py`), from what z is expected to do.

Near to zero, and where the range is so wide that z would be wrong by more than some `ERROR`, the spring is
treated as one with kinks (`kinks.py`): its z is expanded anew, piece by piece, each over a range for which a
quartic is good. The motion of the chain goes by a polynomial that is rougher and does not depart far beyond
the range: near zero the quadratic.
"""

from typing import NamedTuple

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import magnitude, splat, square_root, where_less
from pymc_features.simulators.compiled.vector_math import larger
from pymc_features.simulators.compiled.vector_memory import any_less
from pymc_features.simulators.taylor.powers import (
    ACROSS,
    DEGREE,
    FROM_ZERO,
    HALF,
    HOLD,
    LEFT,
    MIDDLE,
    NARROWNESS,
    NEAR_END,
    OUTSIDE,
    WHOLE,
    replace_polynomial,
    write_polynomial,
)
from pymc_features.simulators.taylor.series import LONG, constant_of, write_constant

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
    """Where to end the first piece of a range."""
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
