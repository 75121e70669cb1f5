"""NORM: every sample an independent Gaussian observation."""

import numpy as np
import pymc as pm

from pymc_features.distributions import GammaFeature
from pymc_features.likelihoods.exact.quadrature import Exponents
from pymc_features.likelihoods.likelihood import DIMS, Likelihood


def declare(given):
    """Add the observed variable.

    Of data with gaps, NaN in an array, by the same density of the samples measured: e_j over sigma_j^2 / N_j
    is chi-square with N_j degrees of freedom.
    """
    if isinstance(given.observed, np.ndarray) and np.isnan(given.observed).any():
        n = (~np.isnan(given.observed)).sum(axis=-1).astype(np.float64)
        sigma = given.sigma / np.sqrt(n)
        GammaFeature("y", given.mu, sigma, m=n, density="data", observed=given.observed, dims=DIMS)
        return
    sigma = given.sigma[:, None] if given.sigma.ndim else given.sigma
    pm.Normal("y", mu=given.mu, sigma=sigma, observed=given.observed, dims=DIMS)


def exponents(n_sensors: int, n_times: int) -> Exponents:
    """Eq. (2) in powers of sigma and S."""
    n = n_sensors * n_times
    return Exponents(n, n_times, -0.5 * n * np.log(2.0 * np.pi))


NORM = Likelihood(
    "NORM",
    "every sample an independent Gaussian observation, Eq. (2)",
    "#0072B2",
    declare,
    exponents,
    reasons={"narrows": "sampling faster is taken for new information"},
)
