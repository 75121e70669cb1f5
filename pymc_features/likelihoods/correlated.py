"""CN: Gaussian errors correlated in time; correlation time tau and scale sigma are known or inferred."""

import numpy as np

from pymc_features.distributions import CorrelatedNormal
from pymc_features.likelihoods.exact.correlated import (
    correlated_exponents,
    known_scale_posterior,
    unknown_time_posterior,
    weighted_square,
)
from pymc_features.likelihoods.exact.step import PARAMETERS, Reference, posterior_of_curve, rows
from pymc_features.likelihoods.likelihood import DIMS, Likelihood

TAKES = ("sigma", "correlation_time")


def declare(given):
    """Add the observed variable."""
    CorrelatedNormal(
        "y", given.mu, given.sigma, given.correlation_time, given.dt, observed=given.observed, dims=DIMS
    )


def all_known(step) -> Reference:
    """Theta, with tau and sigma known."""
    curve = step.weighted_curve
    exponents = correlated_exponents(*step.shape, step.dt, step.priors.known_tau)
    marginal, log_evidence = known_scale_posterior(curve, exponents, step.priors.known_sigma)
    return Reference(
        rows({"theta": curve.minimiser}, {"theta": marginal}),
        log_evidence,
        lambda draws: -np.interp(draws["theta"], curve.theta, curve.values),
    )


def known_time(step) -> Reference:
    """Theta and sigma, with tau known."""
    exponents = correlated_exponents(*step.shape, step.dt, step.priors.known_tau)
    return posterior_of_curve(step.weighted_curve, exponents, step.priors.sigma)


def unknown_time(step) -> Reference:
    """Theta, sigma and tau."""
    curve, sums, priors = step.curve, step.node_sums, step.priors
    marginals, best, log_evidence = unknown_time_posterior(
        curve, sums, step.shape, step.dt, priors.sigma, priors.tau
    )

    def log_density(draws):
        at_draws = np.array([np.interp(draws["theta"], curve.theta, row) for row in sums])
        exponents = correlated_exponents(*step.shape, step.dt, draws["tau"])
        weighted, sigma = weighted_square(at_draws, step.dt, draws["tau"]), draws["sigma"]
        return exponents.constant - exponents.m * np.log(sigma) - 0.5 * weighted / sigma**2

    return Reference(rows(dict(zip(PARAMETERS, best, strict=True)), marginals), log_evidence, log_density)


CN = Likelihood(
    "CN",
    "errors correlated in time; tau and sigma known",
    "#D55E00",
    declare,
    posterior=all_known,
    takes=TAKES,
    known=TAKES,
    takes_gaps=False,
)
CN_SIGMA = Likelihood(
    "CN-SIGMA",
    "errors correlated in time; tau known, sigma inferred",
    "#56B4E9",
    declare,
    posterior=known_time,
    takes=TAKES,
    known=("correlation_time",),
    inferred=("sigma",),
    takes_gaps=False,
    reasons={"widens": "the errors do not have the correlation assumed, and sigma grows for it"},
)
CN_TAU = Likelihood(
    "CN-TAU",
    "errors correlated in time; tau and sigma inferred",
    "#882255",
    declare,
    posterior=unknown_time,
    takes=TAKES,
    inferred=TAKES,
    takes_gaps=False,
    reasons={"narrows": "white noise is found, and sampling it faster is taken for new information"},
)
