"""EXP: exponential on the mean square of each sensor."""

import numpy as np

from pymc_features.distributions import ExpFeature
from pymc_features.likelihoods.exact.quadrature import Exponents
from pymc_features.likelihoods.likelihood import DIMS, Likelihood


def declare(given):
    """Add the observed variable."""
    ExpFeature("y", mu=given.mu, sigma=given.sigma, density=given.density, observed=given.observed, dims=DIMS)


def exponents(n_sensors: int, n_times: int) -> Exponents:
    """Eq. (9) in powers of sigma and S."""
    return Exponents(2 * n_sensors, 1.0, -n_sensors * np.log(2.0))


EXP = Likelihood(
    "EXP",
    "exponential on the mean square of each sensor, Eq. (9)",
    "#009E73",
    declare,
    exponents,
)
