"""TN: half-normal on the root mean square of each sensor."""

import numpy as np

from pymc_features.distributions import TruncNormalFeature
from pymc_features.likelihoods.exact.quadrature import Exponents
from pymc_features.likelihoods.likelihood import DIMS, Likelihood


def declare(given):
    """Add the observed variable."""
    TruncNormalFeature(
        "y", mu=given.mu, sigma=given.sigma, density=given.density, observed=given.observed, dims=DIMS
    )


def exponents(n_sensors: int, n_times: int) -> Exponents:
    """Eq. (7) in powers of sigma and S."""
    return Exponents(n_sensors, 1.0, 0.5 * n_sensors * np.log(2.0 / np.pi))


TN = Likelihood(
    "TN",
    "half-normal on the root mean square of each sensor, Eq. (7)",
    "#E69F00",
    declare,
    exponents,
)
