"""GAMMA: any number of independent observations of each sensor."""

from pymc_features.distributions import GammaFeature
from pymc_features.likelihoods.likelihood import DIMS, Likelihood


def declare(given):
    """Add the observed variable."""
    GammaFeature(
        "y",
        mu=given.mu,
        sigma=given.sigma,
        m=given.m,
        density=given.density,
        observed=given.observed,
        dims=DIMS,
    )


GAMMA = Likelihood(
    "GAMMA",
    "chi-square on the mean square of each sensor, with m degrees of freedom",
    "#4B0000",
    declare,
    takes=("sigma", "m"),
    known=("m",),
)
