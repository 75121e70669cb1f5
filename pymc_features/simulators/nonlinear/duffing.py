"""The Duffing law: a spring that hardens with the cube of its drift, f = k d + c d^3."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.vector import magnitude, splat, square_root
from pymc_features.simulators.nonlinear.law import Functions, parameter, register, single
from pymc_features.simulators.taylor.adjoint.series import Adjoint, add_constant, correlation
from pymc_features.simulators.taylor.series import (
    Group,
    Series,
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


def partials(law, row, stiffness, drift, rate, z, branch):
    """By stiffness, drift, rate, z and c."""
    square, zero = drift * drift, splat(0.0)
    tangent_stiffness = stiffness + 3.0 * (parameter(law, 0, row) * square)
    return (drift, tangent_stiffness, zero, zero, square * drift), (zero, zero, zero, zero, zero)


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


STIFFNESS, COEFFICIENT = range(2)  # constants
DRIFTS, SQUARES = range(2)  # series
FORCES = 0  # series of bars


def expand(spring, k, drift, rate):
    """f_k = k d_k + c (d d^2)_k."""
    write_coefficient(spring, DRIFTS, k, drift)
    write_coefficient(spring, SQUARES, k, square(spring, DRIFTS, k))
    cube = product(spring, DRIFTS, SQUARES, k)
    return constant_of(spring, STIFFNESS) * drift + constant_of(spring, COEFFICIENT) * cube


def reverse(spring, bars, k, drift, rate, force):
    """With fbar: dbar_k = k fbar_k + 3 c sum_j fbar_j (d^2)_j-k, cbar = sum_jk fbar_j (d^2)_j-k d_k."""
    write_coefficient(bars, FORCES, k, force)
    by_cube = correlation(bars, FORCES, spring, SQUARES, k)
    add_constant(bars, STIFFNESS, force * drift)
    add_constant(bars, COEFFICIENT, by_cube * drift)
    tangent = 3.0 * constant_of(spring, COEFFICIENT)
    return constant_of(spring, STIFFNESS) * force + tangent * by_cube, splat(0.0)


class CubicGroup(Group):
    """Chains in lanes, of this law."""


SERIES = Series(
    order=10,
    tolerance=2.5e-7,
    n_series=2,
    n_constants=2,
    serves=lambda values: (values[0] >= 0.0) & (values[0] < np.inf),
    constants=lambda stiffness, values: [stiffness, values[0]],
    expand=expand,
    adjoint=Adjoint(1, reverse),
)
register(Cubic, Functions(1, spring, partials, step_rate, is_admissible, has_kinks, {CubicGroup: SERIES}))
