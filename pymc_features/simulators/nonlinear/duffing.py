"""The Duffing law: a spring that hardens with the cube of its drift, f = k d + c d^3."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.vector import magnitude, splat, square_root
from pymc_features.simulators.nonlinear.law import Functions, parameter, register, single
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


class Cubic(NamedTuple):
    """The parameter of each spring: cubic coefficient c [N/m^3]."""

    address: int
    rows: int
    n: int


def spring(law, row, stiffness, drift, rate, z, branch):
    """f = k d + c d^3; there is no internal variable."""
    return drift * (stiffness + parameter(law, 0, row) * (drift * drift)), splat(0.0)


def step_rate(law, row, stiffness, omega, drift, rate, acceleration):
    """Growth of the frequency with the tangent stiffness k + 3 c d^2, now and soon, and from rest."""
    hardening = square_root(3.0 * parameter(law, 0, row) / stiffness)
    growth = hardening * (omega * magnitude(drift) + magnitude(rate))
    return growth + square_root(hardening * magnitude(acceleration))


def is_admissible(law, i):
    """A hardening spring."""
    return 0.0 <= single(law, 0, i) < np.inf


def has_kinks(law):
    """A polynomial has none."""
    return False


ORDER = 9
STIFFNESS, COEFFICIENT = range(2)  # constants
DRIFTS, SQUARES = range(2)  # series
CUBES_BAR, FORCES = range(2)  # series of bars: of (d^3)_k / c, then of the force


def expand(spring, k, drift, rate):
    """f_k = k d_k + c (d d^2)_k."""
    write_coefficient(spring, DRIFTS, k, drift)
    write_coefficient(spring, SQUARES, k, square(spring, DRIFTS, k))
    cube = product(spring, DRIFTS, SQUARES, k)
    return constant_of(spring, STIFFNESS) * drift + constant_of(spring, COEFFICIENT) * cube


def reverse(spring, bars, k, force):
    """With fbar: dbar_k = k fbar_k + 3 c sum_j fbar_j (d^2)_j-k."""
    by_cube = correlation(bars, FORCES, spring, SQUARES, k)
    write_coefficient(bars, CUBES_BAR, k, by_cube)
    tangent = 3.0 * constant_of(spring, COEFFICIENT)
    return constant_of(spring, STIFFNESS) * force + tangent * by_cube, splat(0.0), splat(0.0)


def reverse_sums(spring, bars, drift, loading, sign):
    """kbar = sum_k fbar_k d_k, cbar = sum_jk fbar_j (d^2)_j-k d_k."""
    by_stiffness = by_coefficient = splat(0.0)
    for k in range(ORDER):
        own = coefficient(spring, DRIFTS, k)
        by_stiffness = by_stiffness + coefficient(bars, FORCES, k) * own
        by_coefficient = by_coefficient + coefficient(bars, CUBES_BAR, k) * own
    add_constant(bars, STIFFNESS, by_stiffness)
    add_constant(bars, COEFFICIENT, by_coefficient)


class CubicGroup(Group):
    """Chains in lanes, of this law."""


SERIES = Series(
    order=ORDER,
    tolerance=6e-8,
    n_series=2,
    n_constants=2,
    serves=lambda values: (values[0] >= 0.0) & (values[0] < np.inf),
    constants=lambda stiffness, values: [stiffness, values[0]],
    expand=expand,
    adjoint=Adjoint(FORCES, reverse, reverse_sums),
)
register(Cubic, Functions(1, spring, step_rate, is_admissible, has_kinks, {CubicGroup: SERIES}))
