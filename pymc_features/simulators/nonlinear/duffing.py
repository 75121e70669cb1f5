"""The Duffing law: a spring that hardens with the cube of its drift."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.vector import magnitude, splat, square_root
from pymc_features.simulators.nonlinear.law import Functions, parameter, register, single


class Cubic(NamedTuple):
    """The parameter of each spring: cubic coefficient [N/m^3]."""

    address: int
    rows: int
    n: int


def spring(law, row, stiffness, drift, rate, memory, branch):
    """f = k d + c d^3; there is no internal variable."""
    return drift * (stiffness + parameter(law, 0, row) * (drift * drift)), splat(0.0)


def partials(law, row, stiffness, drift, rate, memory, branch):
    """Of a polynomial."""
    square, nothing = drift * drift, splat(0.0)
    tangent = stiffness + 3.0 * (parameter(law, 0, row) * square)
    return (drift, tangent, nothing, nothing, square * drift), (nothing, nothing, nothing, nothing, nothing)


def pace(law, row, stiffness, omega, drift, rate, change):
    """Growth of the frequency with the tangent stiffness k + 3 c d^2, now and soon, and from rest."""
    hardening = square_root(3.0 * parameter(law, 0, row) / stiffness)
    fast = hardening * (omega * magnitude(drift) + magnitude(rate))
    return fast + square_root(hardening * magnitude(change))


def is_law(law, i):
    """A hardening spring."""
    return 0.0 <= single(law, 0, i) < np.inf


def has_kinks(law):
    """A polynomial has none."""
    return False


register(Cubic, Functions(1, spring, partials, pace, is_law, has_kinks))
