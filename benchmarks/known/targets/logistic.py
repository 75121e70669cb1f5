"""Logistic regression: 200 synthetic observations, nine correlated covariates and an intercept.

The answer is of long chains and importance sampling, as those of the structures.
"""

import numpy as np
import pymc as pm

from benchmarks.known.answer import Problem
from benchmarks.known.saved import saved_answer

OBSERVATIONS = 200
CORRELATION = 0.7  # of neighbouring covariates
PRIOR_SD = 2.5


def declare(d):
    """The model with d coefficients."""
    rng = np.random.default_rng(3)
    lag = np.abs(np.subtract.outer(np.arange(d - 1), np.arange(d - 1)))
    factor = np.linalg.cholesky(CORRELATION**lag)
    covariates = np.column_stack(
        [np.ones(OBSERVATIONS), rng.standard_normal((OBSERVATIONS, d - 1)) @ factor.T]
    )
    coefficients = rng.normal(0.0, 1.0, d)
    observed = rng.random(OBSERVATIONS) < 1.0 / (1.0 + np.exp(-covariates @ coefficients))
    with pm.Model() as model:
        beta = pm.Normal("beta", 0.0, PRIOR_SD, shape=d)
        pm.Bernoulli("y", logit_p=covariates @ beta, observed=observed.astype(int))
    return model


def build(d=10):
    """Return the problem; its answer is saved for ten coefficients."""
    return Problem(declare(d), saved_answer(f"logistic-{d}"))
