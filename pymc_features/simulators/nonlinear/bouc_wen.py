"""The Bouc-Wen law: smooth hysteresis between an elastic and a post-yield stiffness."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.vector import magnitude, splat, square_root, where_less
from pymc_features.simulators.compiled.vector_math import logarithm, power
from pymc_features.simulators.nonlinear.law import Functions, parameter, register, single

YIELD, RATIO, SHARPNESS, BETA, GAMMA = range(5)


class BoucWen(NamedTuple):
    """Parameters of each spring: yield displacement [m], post-yield ratio, sharpness, beta and gamma [-]."""

    address: int
    rows: int
    n: int


def spring(law, row, stiffness, drift, rate, memory, branch):
    """f = a k d + (1 - a) k d_y z,  d_y z' = d' [1 - |z|^n (gamma + beta b)], b = sign(d' z) the branch."""
    reach, ratio = parameter(law, YIELD, row), parameter(law, RATIO, row)
    size = power(magnitude(memory), parameter(law, SHARPNESS, row))
    loss = parameter(law, GAMMA, row) + branch * parameter(law, BETA, row)
    force = stiffness * (ratio * drift + (1.0 - ratio) * (reach * memory))
    return force, rate * (1.0 - size * loss) / reach


def partials(law, row, stiffness, drift, rate, memory, branch):
    """|z|^n has the derivatives n |z|^n / z and |z|^n log |z|, both 0 at z = 0."""
    reach, ratio = parameter(law, YIELD, row), parameter(law, RATIO, row)
    sharpness = parameter(law, SHARPNESS, row)
    size = power(magnitude(memory), sharpness)
    loss = parameter(law, GAMMA, row) + branch * parameter(law, BETA, row)
    nothing, hysteretic = splat(0.0), 1.0 - ratio
    slip = 0.0 - rate * size / reach  # of z', by the loss
    by_memory = where_less(nothing, size, slip * loss * sharpness / memory, nothing)
    by_rate = (1.0 - size * loss) / reach
    elastic = drift - reach * memory
    force = (
        *(ratio * drift + hysteretic * (reach * memory), stiffness * ratio, nothing),
        *(stiffness * hysteretic * reach, stiffness * hysteretic * memory, stiffness * elastic),
        *(nothing, nothing, nothing),
    )
    by_sharpness = slip * loss * logarithm(magnitude(memory))
    change = (
        *(nothing, nothing, by_rate, by_memory, 0.0 - rate * by_rate / reach, nothing),
        *(by_sharpness, slip * branch, slip),
    )
    return force, change


def pace(law, row, stiffness, omega, drift, rate, change):
    """Half of (1 + n) |d'| / d_y, about the slope of the law, and its like for a drift about to start."""
    sharp = 0.5 * (1.0 + parameter(law, SHARPNESS, row)) / parameter(law, YIELD, row)
    return sharp * magnitude(rate) + square_root(sharp * magnitude(change))


def is_law(law, i):
    """Positive yield displacement, ratio in [0, 1], n >= 1 and 0 <= gamma <= beta: loops dissipate."""
    beta = single(law, BETA, i)
    positive = 0.0 < single(law, YIELD, i) < np.inf and 0.0 <= single(law, RATIO, i) <= 1.0
    shape = 1.0 <= single(law, SHARPNESS, i) < np.inf and 0.0 < beta < np.inf
    return positive and shape and 0.0 <= single(law, GAMMA, i) <= beta


def has_kinks(law):
    """At reversals, and where the force of the hysteretic part changes its sign."""
    return True


register(BoucWen, Functions(5, spring, partials, pace, is_law, has_kinks))
