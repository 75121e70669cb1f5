"""The Bouc-Wen law: smooth hysteresis between an elastic and a post-yield stiffness."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.restoring import Functions, register

YIELD, RATIO, SHARPNESS, BETA, GAMMA = range(5)


class BoucWen(NamedTuple):
    """Rows of `values` (5, n): yield displacement [m], post-yield ratio, sharpness, beta and gamma [-]."""

    values: np.ndarray


def spring(law, i, stiffness, drift, rate, memory):
    """f = a k d + (1 - a) k d_y z,  d_y z' = d' [1 - |z|^n (gamma + beta sign(d' z))]."""
    reach = law.values[YIELD, i]
    ratio = law.values[RATIO, i]
    sharpness = law.values[SHARPNESS, i]
    size = abs(memory)
    power = size * size if sharpness == 2.0 else size**sharpness
    loss = law.values[GAMMA, i] + (law.values[BETA, i] if rate * memory > 0.0 else -law.values[BETA, i])
    force = stiffness * (ratio * drift + (1.0 - ratio) * reach * memory)
    return force, rate * (1.0 - power * loss) / reach


def pace(law, i, stiffness, omega, drift, rate, change):
    """Half of (1 + n) |d'| / d_y, about the slope of the law, and its like for a drift about to start."""
    sharp = 0.5 * (1.0 + law.values[SHARPNESS, i]) / law.values[YIELD, i]
    return sharp * abs(rate) + np.sqrt(sharp * abs(change))


def is_law(law, i):
    """Positive yield displacement, ratio in [0, 1], n >= 1 and 0 <= gamma <= beta: loops dissipate."""
    positive = 0.0 < law.values[YIELD, i] < np.inf and 0.0 <= law.values[RATIO, i] <= 1.0
    shape = 1.0 <= law.values[SHARPNESS, i] < np.inf and 0.0 < law.values[BETA, i] < np.inf
    return positive and shape and 0.0 <= law.values[GAMMA, i] <= law.values[BETA, i]


def has_kinks(law):
    """At reversals, and where the force of the hysteretic part changes its sign."""
    return True


register(BoucWen, Functions(spring, pace, is_law, has_kinks))
