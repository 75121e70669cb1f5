"""A correlated Gaussian posterior with condition number 1000, under a Gaussian prior.

x ~ N(0, s^2 I), ln L = -(x - y)' Lambda (x - y) / 2. The posterior is N(m, P^-1) with P = Lambda + I / s^2,
chosen with eigenvalues from 1 to 1000 in random directions, P m = Lambda y, and

    ln Z = ln L(m) - m' m / (2 s^2) - ln det(s^2 P) / 2.
"""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from scipy import stats

from benchmarks.known.answer import PROBABILITIES, Answer, Problem

PRIOR_SD = 10.0
CONDITION = 1000.0


def build(d):
    """Return the problem in d dimensions."""
    rng = np.random.default_rng(d)
    directions = np.linalg.qr(rng.standard_normal((d, d)))[0]
    eigenvalues = np.geomspace(1.0, CONDITION, d)
    of_data = eigenvalues - 1.0 / PRIOR_SD**2
    mean = rng.standard_normal(d)
    along = directions.T @ mean
    data = directions @ (eigenvalues / of_data * along)  # Lambda y = P m
    precision = directions * of_data @ directions.T
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, PRIOR_SD, shape=d)
        pm.Potential("likelihood", -0.5 * pt.dot(x - data, pt.dot(precision, x - data)))

    covariance = directions / eigenvalues @ directions.T
    factor = np.linalg.cholesky(covariance)
    sd = np.sqrt(np.diag(covariance))
    # -2 ln of likelihood times prior at the mean, and the Gaussian integral around it
    squares = of_data @ (directions.T @ (mean - data)) ** 2 + mean @ mean / PRIOR_SD**2
    log_z = -0.5 * squares - 0.5 * np.log(PRIOR_SD**2 * eigenvalues).sum()
    answer = Answer.exact(
        [f"x[{i}]" for i in range(d)],
        mean + sd * stats.norm.ppf(PROBABILITIES)[:, None],
        log_z,
    )
    return Problem(model, answer, draws=lambda n, rng: mean + rng.standard_normal((n, d)) @ factor.T)
