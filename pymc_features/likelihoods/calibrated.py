"""CAL: the width that the residuals of a fit support, by `calibrate`."""

import numpy as np

from pymc_features.calibration.comparison import Comparison
from pymc_features.calibration.fit import Event
from pymc_features.calibration.sandwich import sandwich, stretching
from pymc_features.likelihoods.exact.quadrature import Exponents, Stretch, exact_posterior
from pymc_features.likelihoods.exact.step import PARAMETERS, Reference, rows
from pymc_features.likelihoods.independent import NORM
from pymc_features.likelihoods.likelihood import Likelihood

DIFFERENCE = 1e-4  # of theta, over which the response is differentiated


def stretched(step) -> tuple[float, Stretch, Stretch]:
    """Power of NORM's likelihood, and how it is stretched along theta and sigma.

    Its maximum follows from S(theta), its curvature A in closed form. theta and sigma do not mix: neither in
    A nor in the covariance B of the score. The model is the structure, so that bands are not compared.
    """
    curve, norm, priors = step.curve, NORM.exponents(*step.shape), step.priors
    theta, sigma = curve.minimiser, np.sqrt(norm.c * curve.minimum / norm.m)
    # slopes of theta and ln(sigma) by the unconstrained parameters
    low, high = priors.theta
    of_theta = (theta - low) * (high - theta) / (high - low)
    of_sigma = 1.0 - sigma / priors.sigma[1]
    ends = [step.response(theta + sign * DIFFERENCE) for sign in (1.0, -1.0)]
    slope = (ends[0] - ends[1]) / (2.0 * DIFFERENCE * sigma) * of_theta
    n_sensors, n_times = step.shape
    value = Comparison(step.response(theta), step.data.values, sigma, n_times, step=step.dt).by_sensor()
    slopes = np.stack([slope, np.zeros_like(slope)], axis=-1)
    of_scale = np.tile([0.0, of_sigma], (n_sensors, 1))
    event = Event(value, value.residuals, slopes, of_scale, step.frequencies(theta))
    curvature = norm.c * curve.curvature * (of_theta / sigma) ** 2
    information = np.diag([curvature, 2.0 * norm.m * of_sigma**2])
    precision = sandwich([event], model_error=None)._replace(information=information).precision
    power, matrix = stretching(information, precision)
    return (
        power,
        Stretch(priors.theta, theta, float(matrix[0, 0])),
        Stretch(priors.sigma, float(sigma), float(matrix[1, 1])),
    )


def exact(step) -> Reference:
    """Theta and sigma under NORM's likelihood to a power, stretched around its maximum."""
    power, *stretches = stretched(step)
    norm, curve = NORM.exponents(*step.shape), step.curve
    raised = Exponents(*(power * np.array([norm.m, norm.c, norm.constant])))
    found = exact_posterior(curve, raised, step.priors.sigma, stretches)

    def log_density(draws):
        theta, sigma = (s.inside(draws[name]) for s, name in zip(stretches, PARAMETERS, strict=False))
        values = np.interp(theta, curve.theta, curve.values)
        return -raised.m * np.log(sigma) - raised.c * values / (2.0 * sigma**2)

    best = dict(zip(PARAMETERS, found.map, strict=False))
    return Reference(
        rows(best, {"theta": found.theta, "sigma": found.sigma}), found.log_evidence, log_density
    )


CAL = Likelihood(
    "CAL",
    "the posterior of NORM, made as wide as the residuals of its fit support",
    "black",
    NORM.declare,
    posterior=exact,
    reasons={"narrows": "residuals that are white at every step do tell more where there are more of them"},
    calibrates="NORM",
)
