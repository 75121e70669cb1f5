"""Kinks of the law of a spring, found in a step so that steps can end there.

A law with kinks has one where a kink function passes zero. There are 2n of them: number k < n is the drift
rate of spring k, number n + k is its internal variable z. Within a step each is taken to be the cubic with
its values and slopes at both ends of the step (Hermite interpolation).
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat, where_less
from pymc_features.simulators.compiled.vector_math import larger
from pymc_features.simulators.compiled.vector_memory import (
    all_equal,
    any_less,
    read_lanes,
    read_number,
    write_lanes,
)
from pymc_features.simulators.nonlinear.layout import BRANCH, CROSSINGS, LAST, constant, slope, state
from pymc_features.simulators.nonlinear.state import deformation

MAX_CROSSINGS = 2.0  # of one kink in one step


@jit
def kink_function(law, here, which):
    """Kink function number `which` of the state at `here`; of a slope, its time derivative."""
    p = law.rows * LANES
    first = here * LANES
    if which >= law.n:
        return read_number(law.address, first + 2 * p + which - law.n)
    lower = read_number(law.address, first + p + which - 1) if which > 0 else 0.0
    return read_number(law.address, first + p + which) - lower


@jit
def kink_value(law, s, which):
    """The kink function at stage `s`, and its time derivative."""
    return kink_function(law, state(law, s), which), kink_function(law, slope(law, s), which)


@jit
def set_branches(law, ahead):
    """Set the springs' branches from the state extrapolated by `ahead` [s]; return whether any changed.

    The extrapolation is needed at a kink, where one of the two functions is zero but for rounding. If one
    stays zero, at rest, the spring is about to be loaded.
    """
    changed = False
    here, rates = state(law, 0), slope(law, 0)
    for row in range(law.rows):
        third = 2 * law.rows + row
        rate = deformation(law, here, row)[1] + ahead * deformation(law, rates, row)[1]
        z = read_lanes(law.address, here + third) + ahead * read_lanes(law.address, rates + third)
        branch = where_less(rate * z, splat(0.0), splat(-1.0), splat(1.0))
        changed |= not all_equal(branch, constant(law, BRANCH, row))
        write_lanes(law.address, BRANCH * law.rows + row, branch)
    return changed


@jit
def cubic(c, x):
    """Value of a polynomial with four coefficients, the constant one first."""
    return c[0] + x * (c[1] + x * (c[2] + x * c[3]))


@jit
def cubic_root(c, high):
    """Root in (0, high) of a cubic whose values at 0 and `high` differ in sign: Newton, kept in a bracket."""
    low, positive = 0.0, c[0] > 0.0
    x = high * c[0] / (c[0] - cubic(c, high))
    if not low <= x <= high:  # rounding errors have the signs that are not expected
        x = 0.5 * high
    for _ in range(8):
        value = cubic(c, x)
        if (value > 0.0) == positive:
            low = x
        else:
            high = x
        x -= value / (c[1] + x * (2.0 * c[2] + x * 3.0 * c[3]))
        if not low <= x <= high:
            x = 0.5 * (low + high)
    return x


@jit
def next_root(before, after, slope_before, slope_after, passed):
    """First root in (0, 1) of the cubic with these values and slopes at 0 and 1; 2 where there is none.

    With `passed` the value at 0 is a root but for its rounding error; the next one is wanted.
    """
    # Hermite interpolation: c0 + c1 x + c2 x^2 + c3 x^3
    second = 3.0 * (after - before) - 2.0 * slope_before - slope_after
    third = 2.0 * (before - after) + slope_before + slope_after
    c = (before, slope_before, second, third)
    if passed:  # divided by x, the cubic is a parabola
        ahead = slope_before * (after - before) < 0.0
        return cubic_root((slope_before, second, third, 0.0), 1.0) if ahead else 2.0
    if before * after < 0.0:
        return cubic_root(c, 1.0)
    if before * slope_before < 0.0 < after * slope_after:  # towards zero, then away: its extreme decides
        lowest = cubic_root((slope_before, 2.0 * second, 3.0 * third, 0.0), 1.0)
        if before * cubic(c, lowest) < 0.0:
            return cubic_root(c, lowest)
    return 2.0


@jit
def may_cross(before, after, change_before, change_after):
    """Whether functions with these values and changes, at a step's ends, may pass zero in it."""
    there = before * (before + change_before)
    back = after * (after - change_after)
    return any_less(before * after, splat(0.0)) or any_less(larger(there, back), splat(0.0))


@jit
def any_kink(law, step):
    """Whether a drift rate or an internal variable may pass zero in the step."""
    found = False
    start, end = state(law, 0), state(law, LAST)
    for row in range(law.rows):
        found |= may_cross(
            deformation(law, start, row)[1],
            deformation(law, end, row)[1],
            step * deformation(law, slope(law, 0), row)[1],
            step * deformation(law, slope(law, LAST), row)[1],
        )
        third = 2 * law.rows + row
        found |= may_cross(
            read_lanes(law.address, start + third),
            read_lanes(law.address, end + third),
            step * read_lanes(law.address, slope(law, 0) + third),
            step * read_lanes(law.address, slope(law, LAST) + third),
        )
    return found


@jit
def first_kink(law, step):
    """The first kink of the step still ahead, -1 if none, and where: a fraction of the step."""
    which, where = -1, 1.0
    if any_kink(law, step):
        first = CROSSINGS * law.rows * LANES
        for k in range(2 * law.n):
            times = read_number(law.address, first + k)
            if times < MAX_CROSSINGS:
                before, slope_before = kink_value(law, 0, k)
                after, slope_after = kink_value(law, LAST, k)
                x = next_root(before, after, step * slope_before, step * slope_after, times > 0.0)
                if x < where:
                    which, where = k, x
    return which, where
