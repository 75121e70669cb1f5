"""Roots and shifts of polynomials in memory, one in each lane."""

from functools import cache

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import magnitude, splat, where_less
from pymc_features.simulators.compiled.vector_math import larger
from pymc_features.simulators.compiled.vector_memory import any_less, read_lanes, write_lanes

MAX_ITERATIONS = 6
NEAR = 3e-3  # change of a root, in steps, after which it is right to the square of that
TINY = 1e-300


@cache
def polynomials_of(order):
    """Return the functions `shift`, `root` and `dip` for polynomials of an order."""

    @jit
    def value_and_slope(address, first, x):
        value, slope = read_lanes(address, first + order), splat(0.0)
        for k in range(order - 1, -1, -1):
            slope = slope * x + value
            value = value * x + read_lanes(address, first + k)
        return value, slope

    @jit
    def shift(address, one, other, x):
        """Move the origin of two polynomials to x."""
        for i in range(order):
            c, d = read_lanes(address, one + order), read_lanes(address, other + order)
            for j in range(order - 1, i - 1, -1):
                c = read_lanes(address, one + j) + x * c
                d = read_lanes(address, other + j) + x * d
                write_lanes(address, one + j, c)
                write_lanes(address, other + j, d)

    @jit
    def root(address, first, sign, at_end, end):
        """Root in (0, end) of sign times a polynomial that is positive at 0 and not at `end`: Newton.

        Where `sign` is zero nothing is looked for.
        """
        zero = splat(0.0)
        start, low, high = larger(sign * read_lanes(address, first), zero), zero, end
        x = end * start / (start - sign * at_end + TINY)
        x = where_less(zero, x, where_less(x, end, x, end), zero)
        leaves = sign * read_lanes(address, first + 1)  # the root at 0 is the kink before
        x = where_less(zero, leaves, larger(x, splat(0.5) * end), x)
        for _ in range(MAX_ITERATIONS):
            value, slope = value_and_slope(address, first, x)
            value, slope = value * sign, slope * sign
            low, high = where_less(zero, value, x, low), where_less(zero, value, high, x)
            better, middle = x - value / (slope - TINY), splat(0.5) * (low + high)
            better = where_less(better, low, middle, better)
            better = where_less(high, better, middle, better)
            change, x = magnitude((better - x) * sign), better
            if not any_less(splat(NEAR), change):
                break
        return x

    @jit
    def dip(address, first, sign):
        """Where sign times a polynomial that first falls is lowest in (0, 1), and the polynomial there."""
        zero, one, x = splat(0.0), splat(1.0), splat(0.5)
        for _ in range(3):
            slope, bend = float(order) * read_lanes(address, first + order), zero
            for k in range(order - 1, 0, -1):
                bend = bend * x + slope
                slope = slope * x + float(k) * read_lanes(address, first + k)
            x = x - slope / (bend + sign * TINY)
            x = where_less(zero, x, where_less(x, one, x, one), zero)
        return x, value_and_slope(address, first, x)[0]

    return shift, root, dip
