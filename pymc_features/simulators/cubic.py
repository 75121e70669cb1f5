"""The Duffing law: a spring that hardens with the cube of its drift."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.restoring import Functions, register


class Cubic(NamedTuple):
    """The row of `values` (1, n): cubic coefficient [N/m^3]."""

    values: np.ndarray


def spring(law, i, stiffness, drift, rate, memory):
    """f = k d + c d^3; there is no internal variable."""
    return drift * (stiffness + law.values[0, i] * drift * drift), 0.0


def pace(law, i, stiffness, omega, drift, rate, change):
    """Growth of the frequency with the tangent stiffness k + 3 c d^2, now and soon, and from rest."""
    hardening = np.sqrt(3.0 * law.values[0, i] / stiffness)
    return hardening * (omega * abs(drift) + abs(rate)) + np.sqrt(hardening * abs(change))


def is_law(law, i):
    """A hardening spring."""
    return 0.0 <= law.values[0, i] < np.inf


def has_kinks(law):
    """A polynomial has none."""
    return False


register(Cubic, Functions(spring, pace, is_law, has_kinks))
