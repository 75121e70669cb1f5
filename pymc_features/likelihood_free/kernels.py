"""Kernels of ABC: log-densities of the mean squares e (sensor,) of a simulation under a tolerance epsilon.

They depend on rho = sum_j e_j, or with one tolerance for each sensor on sum_j e_j / epsilon_j in the place of
rho / epsilon.
"""

import numpy as np
import pytensor.tensor as pt

from pymc_features.likelihood_free.functions import ADVICE
from pymc_features.ops import NoGradient, mean_square_discrepancy

INSIDE, OUTSIDE = (pt.constant(value, dtype="float64") for value in (0.0, -np.inf))


def uniform_kernel(epsilon, e):
    """Accept where rho <= epsilon, Eq. (14): 0 inside and -inf outside; exact at the edge."""
    tolerance, rho = tolerance_and_rho(epsilon, e)
    return pt.switch(rho <= tolerance, INSIDE, OUTSIDE)


def exponential_kernel(epsilon, e):
    """-sum_j (ln epsilon_j + e_j / epsilon_j): the EXP likelihood at sigma_j^2 = epsilon_j / 2."""
    return -pt.sum(pt.log(epsilon) + e / epsilon, axis=-1)


def gaussian_kernel(epsilon, e):
    """-(rho / epsilon)^2 / 2, PyMC's own soft kernel on rho."""
    tolerance, rho = tolerance_and_rho(epsilon, e)
    return -0.5 * pt.sqr(rho / tolerance)


KERNELS = {
    "uniform": uniform_kernel,
    "exponential": exponential_kernel,
    "gaussian": gaussian_kernel,
}

NO_GRADIENT_OF_FUNCTION = NoGradient(f"a function passed to DiscrepancySimulator has no gradient. {ADVICE}")
NO_GRADIENT_OF_THRESHOLD = NoGradient(
    f"the hard threshold of DiscrepancySimulator has no gradient. {ADVICE} The exponential and the gaussian "
    "kernel are differentiable."
)


class Distance:
    """What `pm.Simulator` calls a distance: one of `KERNELS` at rho = sum_j e_j, Eq. (15)."""

    def __init__(self, kernel: str):
        self.kernel = kernel
        self.hard = kernel == "uniform"

    def __call__(self, epsilon, observed, simulated):
        if observed.ndim == 1:  # a summary: each entry counts once
            e = pt.sqr(observed - simulated)
        else:
            e = mean_square_discrepancy(simulated, observed)
        return NO_GRADIENT_OF_FUNCTION(self.of_discrepancy(epsilon, e))

    def of_discrepancy(self, epsilon, e):
        """Log-density for mean squares e (sensor,); what failed is infinitely far."""
        density = KERNELS[self.kernel](epsilon, pt.switch(pt.isnan(e), np.inf, e))
        return NO_GRADIENT_OF_THRESHOLD(density) if self.hard else density

    @property
    def minus_rho(self):
        """The distance whose log-density is -rho: what a sampler that lowers the tolerance looks at."""
        return MinusRho(self.kernel)


class MinusRho(Distance):
    """-rho in the place of a kernel; -rho / epsilon where epsilon has one value for each sensor."""

    def of_discrepancy(self, epsilon, e):
        """-rho for mean squares e (sensor,)."""
        return -tolerance_and_rho(epsilon, pt.switch(pt.isnan(e), np.inf, e))[1]


def tolerance_and_rho(epsilon, e):
    """Tolerance and rho, Eq. (15); with one tolerance for each sensor, 1 and sum_j e_j / epsilon_j."""
    if epsilon.ndim == 0:
        return epsilon, pt.sum(e, axis=-1)
    return pt.ones(()), pt.sum(e / epsilon, axis=-1)
