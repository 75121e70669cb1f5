"""A spring that hardens with an odd power of its drift, f = k d + c d^p: the law of a power p."""

import numpy as np

from pymc_features.simulators.nonlinear.law import Functions, parameter, single
from pymc_features.simulators.numbers.compiled_numbers import magnitude, square_root
from pymc_features.simulators.numbers.vectors import splat
from pymc_features.simulators.taylor.adjoint.series import Adjoint, add_constant, correlation
from pymc_features.simulators.taylor.series import (
    Group,
    Series,
    coefficient,
    constant_of,
    product,
    square,
    write_coefficient,
)

STIFFNESS, COEFFICIENT = range(2)  # constants
DRIFTS, SQUARES = range(2)  # series: d, d^2, and behind them d^4, d^6 ... d^(p - 1)
POWERS_BAR, FORCES = range(2)  # series of bars: of (d^p)_k / c, then of the force


def polynomial(group: type[Group], power: int, order: int = 10, tolerance: float = 6e-8) -> Functions:
    """The law with this power, whose parameter is the coefficient c [N/m^p], not negative.

    Parameters
    ----------
    group : type
        A subclass of `Group` for this law alone, at the top of its module.
    power : int
        p, an odd number from three on.
    order, tolerance
        As of `Series`.
    """
    n_even = power // 2  # series of even powers, of which the last is d^(p - 1)

    def spring(law, row, stiffness, drift, rate, z, branch):
        """f = k d + c d^p; there is no internal variable."""
        squared = drift * drift
        even = squared
        for _ in range(n_even - 1):
            even = even * squared
        return drift * (stiffness + parameter(law, 0, row) * even), splat(0.0)

    def step_rate(law, row, stiffness, omega, drift, rate, acceleration):
        """Growth of the frequency with the tangent stiffness k + p c d^(p - 1), now, soon, and from rest."""
        hardening = square_root(float(power) * parameter(law, 0, row) / stiffness)
        for _ in range(n_even - 1):
            hardening = hardening * magnitude(drift)
        growth = hardening * (omega * magnitude(drift) + float(n_even) * magnitude(rate))
        return growth + square_root(hardening * magnitude(acceleration))

    def is_admissible(law, i):
        """A hardening spring."""
        return 0.0 <= single(law, 0, i) < np.inf

    def has_kinks(law):
        """A polynomial has none."""
        return False

    def expand(spring, k, drift, rate):
        """f_k = k d_k + c (d d^(p - 1))_k."""
        write_coefficient(spring, DRIFTS, k, drift)
        write_coefficient(spring, SQUARES, k, square(spring, DRIFTS, k))
        for m in range(1, n_even):
            write_coefficient(spring, SQUARES + m, k, product(spring, m, SQUARES, k))
        own = product(spring, DRIFTS, n_even, k)
        return constant_of(spring, STIFFNESS) * drift + constant_of(spring, COEFFICIENT) * own

    def reverse(spring, bars, k, force):
        """With fbar: dbar_k = k fbar_k + p c sum_j fbar_j (d^(p - 1))_j-k."""
        own = correlation(bars, FORCES, spring, n_even, k)
        write_coefficient(bars, POWERS_BAR, k, own)
        tangent = float(power) * constant_of(spring, COEFFICIENT)
        return constant_of(spring, STIFFNESS) * force + tangent * own, splat(0.0), splat(0.0)

    def reverse_sums(spring, bars, drift, loading, sign):
        """kbar = sum_k fbar_k d_k, cbar = sum_jk fbar_j (d^(p - 1))_j-k d_k."""
        by_stiffness = by_coefficient = splat(0.0)
        for k in range(order):
            own = coefficient(spring, DRIFTS, k)
            by_stiffness = by_stiffness + coefficient(bars, FORCES, k) * own
            by_coefficient = by_coefficient + coefficient(bars, POWERS_BAR, k) * own
        add_constant(bars, STIFFNESS, by_stiffness)
        add_constant(bars, COEFFICIENT, by_coefficient)

    series = Series(
        order=order,
        tolerance=tolerance,
        n_series=1 + n_even,
        n_constants=2,
        serves=lambda values: (values[0] >= 0.0) & (values[0] < np.inf),
        constants=lambda stiffness, values: [stiffness, values[0]],
        expand=expand,
        adjoint=Adjoint(FORCES, reverse, reverse_sums),
    )
    return Functions(1, spring, step_rate, is_admissible, has_kinks, {group: series})
