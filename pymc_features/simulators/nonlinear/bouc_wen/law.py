"""The Bouc-Wen law: smooth hysteresis between an elastic and a post-yield stiffness.

With the yield displacement d_y, the post-yield ratio a, the sharpness n and b = sign(d' z), the branch,

    f = a k d + (1 - a) k d_y z,    z' = d' / d_y [1 - |z|^n (gamma + beta b)].

References
----------
Y. K. Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249-263.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.nonlinear.bouc_wen.any_sharpness import POWERS, AnySharpness
from pymc_features.simulators.nonlinear.bouc_wen.series import (
    BETA,
    GAMMA,
    RATIO,
    SHARPNESS,
    SQUARES,
    YIELD_DISPLACEMENT,
    OneOrTwo,
)
from pymc_features.simulators.nonlinear.law import Functions, parameter, register, single
from pymc_features.simulators.numbers.compiled_numbers import magnitude, square_root
from pymc_features.simulators.numbers.vector_math import power


class BoucWen(NamedTuple):
    """Parameters of each spring: yield displacement [m], post-yield ratio, sharpness, beta and gamma [-]."""

    address: int
    rows: int
    n: int


def spring(law, row, stiffness, drift, rate, z, branch):
    """Both equations above."""
    yield_displacement, ratio = parameter(law, YIELD_DISPLACEMENT, row), parameter(law, RATIO, row)
    power_of_z = power(magnitude(z), parameter(law, SHARPNESS, row))
    loss = parameter(law, GAMMA, row) + branch * parameter(law, BETA, row)
    force = stiffness * (ratio * drift + (1.0 - ratio) * (yield_displacement * z))
    return force, rate * (1.0 - power_of_z * loss) / yield_displacement


def step_rate(law, row, stiffness, omega, drift, rate, acceleration):
    """(1 + n) / 2 |d'| / d_y, and the corresponding term of the drift acceleration where d' = 0."""
    curvature = 0.5 * (1.0 + parameter(law, SHARPNESS, row)) / parameter(law, YIELD_DISPLACEMENT, row)
    return curvature * magnitude(rate) + square_root(curvature * magnitude(acceleration))


def is_admissible(law, i):
    """Positive yield displacement, ratio in [0, 1], n >= 1 and 0 <= gamma <= beta: loops dissipate."""
    beta = single(law, BETA, i)
    positive = 0.0 < single(law, YIELD_DISPLACEMENT, i) < np.inf and 0.0 <= single(law, RATIO, i) <= 1.0
    shape = 1.0 <= single(law, SHARPNESS, i) < np.inf and 0.0 < beta < np.inf
    return positive and shape and 0.0 <= single(law, GAMMA, i) <= beta


def has_kinks(law):
    """At reversals, and where the force of the hysteretic part changes its sign."""
    return True


SERIES = {OneOrTwo: SQUARES, AnySharpness: POWERS}
register(BoucWen, Functions(5, spring, step_rate, is_admissible, has_kinks, SERIES))
