"""Taylor series of the springs in reverse: what a law writes the derivatives of its recurrence with.

Bars stand for derivatives of a scalar L by what the march computes. Coefficient k of a product depends on
coefficient j of a factor by coefficient k - j of the other one, so that

    p = x y  has  xbar_j = sum_{k >= j} pbar_k y_{k-j},
    p = x^m  has  xbar_j = sum_{k >= j} pbar_k (m x^{m-1})_{k-j},

a `correlation`. The recurrence goes from order 0 up, its reverse from the highest order down; where
coefficient k is reached, all that depends on it is known. Bars lie in a memory of the layout of the chains,
with series of their own.
"""

from collections.abc import Callable
from typing import NamedTuple

from pymc_features.simulators.compiled.jit import jit, unrolled
from pymc_features.simulators.compiled.vector import splat
from pymc_features.simulators.taylor.layout import add_lanes
from pymc_features.simulators.taylor.series import coefficient


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
