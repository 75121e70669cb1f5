"""The highest point of a posterior, and a Student distribution around it for a proposal not to miss it.

Where sigma may be small, a narrow peak can stand beside a wide posterior that has most of the mass: chains
enter it too seldom for a fit to see it, but not too seldom to matter.
"""

import numpy as np
from scipy.optimize import minimize

from pymc_features.smc.proposals.proposal import StudentMixture, StudentT

STARTS = 4  # of the climb, the highest draws
DEGREES = 5.0
SHARE = 0.1  # of the mixture
DIFFERENCE = 1e-4


def minus_log_density(target, z):
    """- ln [N(z; 0, I) L(z)] but for a constant, and its gradient, at one point (d,)."""
    value, gradient = target.with_gradient(z[None])
    if not np.isfinite(value[0]):
        return 1e10, np.zeros_like(z)
    return 0.5 * z @ z - value[0], z - gradient[0]


def highest(target, draws):
    """The highest point (d,) that climbs from the highest of draws (n, d) reach."""
    height = target.log_likelihood(draws) - 0.5 * (draws**2).sum(axis=1)
    starts = draws[np.argsort(height)[-STARTS:]]
    climbs = [
        minimize(lambda z: minus_log_density(target, z), z, jac=True, method="L-BFGS-B") for z in starts
    ]
    return min(climbs, key=lambda climb: climb.fun).x


def precision(target, z):
    """Second derivatives (d, d) of minus the log-density, by differences of gradients, made positive."""
    step = DIFFERENCE * np.eye(len(z))
    gradient = target.with_gradient(np.concatenate([z + step, z - step]))[1]
    slopes = (gradient[: len(z)] - gradient[len(z) :]) / (2.0 * DIFFERENCE)
    eigenvalues, directions = np.linalg.eigh(np.eye(len(z)) - 0.5 * (slopes + slopes.T))
    return directions * np.maximum(eigenvalues, 0.2) @ directions.T


def with_peak(target, mixture, draws):
    """The mixture and, with a share of a tenth, a Student distribution at the highest point."""
    top = highest(target, draws)
    factor = np.linalg.cholesky(np.linalg.inv(precision(target, top)))
    weights = np.append((1.0 - SHARE) * mixture.weights, SHARE)
    return StudentMixture([*mixture.components, StudentT(top, factor, DEGREES)], weights)
