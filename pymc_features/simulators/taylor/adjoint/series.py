"""Taylor series of the springs in reverse: what a law writes the derivatives of its recurrence with.

Bars stand for derivatives of a scalar L by what the march computes. Coefficient k of a product depends on
coefficient j of a factor by coefficient k - j of the other one, so that

    p = x y  has  xbar_j = sum_{k >= j} pbar_k y_{k-j},
    p = x^m  has  xbar_j = sum_{k >= j} pbar_k (m x^{m-1})_{k-j},

a `correlation`. The recurrence goes from order 0 up, its reverse from the highest order down; where
coefficient k is reached, all that depends on it is known. Bars lie in a memory of the layout of the chains,
with series of their own.

Bars of polynomials in place of |z|^n (`taylor/powers.py`), at a given range.

The coefficients c_k = c^(n - k) q_k(n) depend on the range as well. As the polynomial is |z|^n to its error
whatever the range, that is left out: P' by |z| is all that z has to do with it.
"""

from collections.abc import Callable
from typing import NamedTuple

from pymc_features.simulators.compiled.jit import jit, unrolled
from pymc_features.simulators.numbers.compiled_numbers import where_less
from pymc_features.simulators.numbers.vector_math import exponential, logarithm
from pymc_features.simulators.numbers.vectors import splat
from pymc_features.simulators.taylor.layout import add_lanes
from pymc_features.simulators.taylor.powers import (
    ACROSS,
    COEFFICIENTS,
    DEGREE,
    EXPONENT,
    HALF,
    MIDDLE,
    OUTSIDE,
    SQUARE,
    economise,
)
from pymc_features.simulators.taylor.series import coefficient, constant_of


class Adjoint(NamedTuple):
    """The derivatives of a recurrence (`Series`), transposed.

    `spring` below has the series and constants of a spring, `bars` (a `Spring` as well) the derivatives of L
    by them; in laws with kinks their first two series are by drift rate and z, the others the law's own.

    Attributes
    ----------
    n_series : int
        Series of bars of each spring, before that of the forces.
    expand : callable
        (spring, bars, k, force) -> bars of coefficients k of drift and drift rate, and what is added to that
        of z, from that of the `force`, which is in its series already. In laws with kinks coefficient k + 1
        of series `Z` is the bar of (k + 1) z_k+1.
    sums : callable
        (spring, bars, drift, loading, sign): add to the bars of the constants what they get from all orders,
        after those; `drift` is that at the beginning of the step, or None where the bars of the forces are
        zero. The last two are those of the branch; its own constants need no bars.
    tangent : callable, optional
        (spring, bars, z, of_tangents, loading, sign) -> bar of z for laws with kinks, from those of the three
        that `Series.tangent` returns; adds to the bars of the constants.
    constants : callable, optional
        As `Series.constants`, where those that have bars are functions of the parameters by arithmetic alone;
        any behind them may be left out.
    fixed : tuple of pairs
        Parameters of the law, by number, and the values that they can only have: their derivatives are NaN.
    """

    n_series: int
    expand: Callable
    sums: Callable
    tangent: Callable | None = None
    constants: Callable | None = None
    fixed: tuple[tuple[int, tuple[float, ...]], ...] = ()


@unrolled
def correlation(bars, by, spring, of, k, shift=0):
    """Sum of coefficient j + `shift` of series `by` of the bars times j - k of series `of`, for j >= k."""
    total = splat(0.0)
    for j in range(k, bars.length - 1):
        total = total + coefficient(bars, by, j + shift) * coefficient(spring, of, j - k)
    return total


@jit
def add_coefficient(bars, series, k, value):
    """Add to coefficient k of a series."""
    add_lanes(bars.address, bars.first + series * bars.length + k, value)


@jit
def add_constant(bars, name, value):
    """Add to the bar of constant number `name`."""
    add_lanes(bars.address, bars.constants + name, value)


@jit
def economised_slopes(n, square):
    """Derivatives by n of the coefficients of `powers.economised`."""
    b2, d2 = n * (n - 1.0) * 0.5, n - 0.5
    b3, d3 = b2 * (n - 2.0) * (1.0 / 3.0), (d2 * (n - 2.0) + b2) * (1.0 / 3.0)
    b4, d4 = b3 * (n - 3.0) * 0.25, (d3 * (n - 3.0) + b3) * 0.25
    b5, d5 = b4 * (n - 4.0) * 0.2, (d4 * (n - 4.0) + b4) * 0.2
    b6, d6 = b5 * (n - 5.0) * (1.0 / 6.0), (d5 * (n - 5.0) + b5) * (1.0 / 6.0)
    d7 = (d6 * (n - 6.0) + b6) * (1.0 / 7.0)
    return economise((splat(1.0), d2, d3, d4, d5, d6, d7), square)


@jit
def add_power(spring, bars, first, factor, of, shape):
    """Add to the bars of n, and of the coefficients of a polynomial from or across zero, where one serves.

    The bars of the coefficients are `factor` times `of`; `shape` is the first constant of such a polynomial.
    """
    zero, n = splat(0.0), constant_of(spring, first + EXPONENT)
    middle, square = constant_of(spring, first + MIDDLE), constant_of(spring, first + SQUARE)
    extent = where_less(zero, middle, middle, constant_of(spring, first + HALF) * (1.0 / OUTSIDE))
    log, inverse = logarithm(extent), 1.0 / extent
    power = factor * exponential(n * log)
    near = where_less(square, zero, splat(1.0), zero)
    total, slopes = zero, economised_slopes(n, square)
    for k in range(DEGREE + 1):
        bar = power * of[k]
        total = total + (1.0 - near) * (bar * slopes[k])
        total = total + log * (factor * (of[k] * constant_of(spring, first + COEFFICIENTS + k)))
        if k < (3 if shape == ACROSS else DEGREE + 1):
            add_constant(bars, first + shape + k, near * bar)
        power = power * inverse
    add_constant(bars, first + EXPONENT, total)
