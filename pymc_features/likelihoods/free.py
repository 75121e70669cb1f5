"""ABC: likelihood-free, with a tolerance on the sum of the mean squares."""

import numpy as np

from pymc_features.likelihood_free import DiscrepancySimulator, abc_tolerance
from pymc_features.likelihoods.exact.quadrature import exact_posterior, tolerance_interval
from pymc_features.likelihoods.exact.step import PARAMETERS, PROBABILITIES, STATISTICS, Reference
from pymc_features.likelihoods.exponential import exponents
from pymc_features.likelihoods.likelihood import DIMS, Likelihood


def declare(given):
    """Add the observed variable."""
    DiscrepancySimulator("y", given.mu, epsilon=given.epsilon, observed=given.observed, dims=DIMS)


def exact_tolerance(step) -> float:
    """delta from the exact EXP posterior, Eq. (16).

    The width of ABC goes with the root of what delta has beyond the smallest rho, which would double the
    relative error of a quantile of draws.
    """
    of_exp = exact_posterior(step.curve, exponents(*step.shape), step.priors.sigma)
    return abc_tolerance(float(of_exp.sigma.quantile(0.9)), step.shape[0])


def exact_interval(step) -> tuple[float, float]:
    """Ends of the exact set {theta: S(theta) <= delta}."""
    return tolerance_interval(step.curve, exact_tolerance(step))


def exact(step) -> Reference:
    """Uniform on {theta: S(theta) <= delta}."""
    curve, (low, high) = step.curve, exact_interval(step)
    table = np.full((len(PARAMETERS), len(STATISTICS)), np.nan)
    table[0] = [curve.minimiser, *(low + np.array(PROBABILITIES) * (high - low))]
    prior = step.priors.theta[1] - step.priors.theta[0]
    return Reference(
        table,
        float(np.log((high - low) / prior)),
        lambda draws: -np.interp(draws["theta"], curve.theta, curve.values),
    )


ABC = Likelihood(
    "ABC",
    "likelihood-free: sum of the mean squares within a tolerance, Eqs. (14)-(15)",
    "#CC79A7",
    declare,
    posterior=exact,
    takes=("epsilon",),
)
