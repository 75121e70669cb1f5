"""Springs that harden with odd powers of their drift, f = k d + sum_j c_j d^p_j: the law of some powers."""

import numpy as np

from pymc_features.simulators.compiled.vector import magnitude, splat, square_root
from pymc_features.simulators.nonlinear.law import Functions, parameter, single
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

STIFFNESS, COEFFICIENTS = 0, 1  # constants: k, then each c_j
DRIFTS, SQUARES = 0, 1  # series: d, d^2, d^4, d^6 ...


def polynomial(
    group: type[Group], powers: tuple[int, ...], order: int = 10, tolerance: float = 6e-8
) -> Functions:
    """The law with these powers, odd and ascending, whose parameters are the c_j in their order.

    Parameters
    ----------
    group : type
        A subclass of `Group` for this law alone, at the top of its module.
    powers : tuple of int
        p_j, three or more.
    order, tolerance
        As of `Series`. 9 is as fast as 10 for cubes.
    """
    n, highest = len(powers), powers[-1] // 2

    def spring(law, row, stiffness, drift, rate, z, branch):
        """Force; there is no internal variable."""
        squared, secant = drift * drift, stiffness
        for j in range(n):
            even = squared
            for _ in range(powers[j] // 2 - 1):
                even = even * squared
            secant = secant + parameter(law, j, row) * even
        return drift * secant, splat(0.0)

    def step_rate(law, row, stiffness, omega, drift, rate, acceleration):
        """Growth of the frequency with the tangent stiffness k + sum_j p c d^(p - 1), now and soon."""
        size, growth = magnitude(drift), splat(0.0)
        for j in range(n):
            hardening = square_root(float(powers[j]) * parameter(law, j, row) / stiffness)
            for _ in range(powers[j] // 2 - 1):
                hardening = hardening * size
            growth = growth + hardening * (omega * size + 0.5 * (powers[j] - 1) * magnitude(rate))
            growth = growth + square_root(hardening * magnitude(acceleration))
        return growth

    def is_admissible(law, i):
        """A hardening spring."""
        possible = True
        for j in range(n):
            possible &= 0.0 <= single(law, j, i) < np.inf
        return possible

    def has_kinks(law):
        """A polynomial has none."""
        return False

    def expand(spring, k, drift, rate):
        """f_k = k d_k + sum_j c_j (d d^(p - 1))_k."""
        write_coefficient(spring, DRIFTS, k, drift)
        write_coefficient(spring, SQUARES, k, square(spring, DRIFTS, k))
        for m in range(1, highest):
            write_coefficient(spring, SQUARES + m, k, product(spring, m, SQUARES, k))
        force = constant_of(spring, STIFFNESS) * drift
        for j in range(n):
            own = product(spring, DRIFTS, powers[j] // 2, k)
            force = force + constant_of(spring, COEFFICIENTS + j) * own
        return force

    def reverse(spring, bars, k, force):
        """With fbar: dbar_k = k fbar_k + sum_j p c (fbar and d^(p - 1) correlated)_k, a series each."""
        total = constant_of(spring, STIFFNESS) * force
        for j in range(n):
            own = correlation(bars, n, spring, powers[j] // 2, k)
            write_coefficient(bars, j, k, own)
            total = total + float(powers[j]) * constant_of(spring, COEFFICIENTS + j) * own
        return total, splat(0.0), splat(0.0)

    def reverse_sums(spring, bars, drift, loading, sign):
        """Add kbar = sum_k fbar_k d_k, and that of each c_j."""
        by_stiffness = splat(0.0)
        for k in range(order):
            by_stiffness = by_stiffness + coefficient(bars, n, k) * coefficient(spring, DRIFTS, k)
        add_constant(bars, STIFFNESS, by_stiffness)
        for j in range(n):
            total = splat(0.0)
            for k in range(order):
                total = total + coefficient(bars, j, k) * coefficient(spring, DRIFTS, k)
            add_constant(bars, COEFFICIENTS + j, total)

    series = Series(
        order=order,
        tolerance=tolerance,
        n_series=1 + highest,
        n_constants=1 + n,
        serves=lambda values: ((values[:n] >= 0.0) & (values[:n] < np.inf)).all(axis=0),
        constants=lambda stiffness, values: [stiffness, *values[:n]],
        expand=expand,
        adjoint=Adjoint(n, reverse, reverse_sums),
    )
    return Functions(n, spring, step_rate, is_admissible, has_kinks, {group: series})
