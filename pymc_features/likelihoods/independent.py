"""NORM: every sample an independent Gaussian observation."""

import numpy as np
import pymc as pm

from pymc_features.likelihoods.exact.quadrature import Exponents
from pymc_features.likelihoods.likelihood import DIMS, Likelihood


def declare(given):
    """Add the observed variable."""
    sigma = given.sigma[:, None] if given.sigma.ndim else given.sigma
    pm.Normal("y", mu=given.mu, sigma=sigma, observed=given.observed, dims=DIMS)


def exponents(n_sensors: int, n_times: int) -> Exponents:
    """Eq. (2) in powers of sigma and S."""
    n = n_sensors * n_times
    return Exponents(n, n_times, -0.5 * n * np.log(2.0 * np.pi))


NORM = Likelihood(
    "NORM",
    "every sample an independent Gaussian observation, Eq. (2)",
    "C0",
    declare,
    exponents,
    reasons={"narrows": "sampling faster is taken for new information"},
)
