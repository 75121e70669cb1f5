"""The structure, its models, and its truth: all factors are one."""

from functools import cache

import numpy as np
import pymc as pm
from scipy.special import logit

import pymc_features as pmf
from pymc_features import datasets
from pymc_features.study import paper

N_FACTORS, N_STOREYS = 3, paper.N_STOREYS
PRIOR_WIDTH = 0.25  # standard deviation of a factor
LARGEST_SIGMA = 5.0  # m/s^2


@cache
def record():
    """Ground acceleration."""
    return datasets.el_centro()


def structure(factors):
    """The chain with factors of its lowest springs."""
    n = factors.type.shape[0] if hasattr(factors, "type") else len(factors)
    return paper.chain().scale_stiffness(factors, springs=list(range(n)))


@cache
def true_response():
    """Floor accelerations (sensor, time) [m/s^2] at the record's step."""
    return pmf.simulate(structure(np.ones(N_FACTORS)), record()).values


def declare(kind, n_factors=N_FACTORS):
    """NORM or CN with theta, sigma (and the correlation), and the data `measured`, which can be changed."""
    with pm.Model() as model:
        theta = pm.Normal("theta", 1.0, PRIOR_WIDTH, shape=n_factors)
        sigma = pm.Uniform("sigma", 0.0, LARGEST_SIGMA)
        measured = pm.Data("measured", true_response())
        mu = pmf.response(structure(theta), record())
        if kind == "NORM":
            pm.Normal("y", mu, sigma, observed=measured)
        else:
            correlation = pm.Uniform("correlation", 0.0, 1.0)  # of neighbouring samples
            tau = -record().dt / pm.math.log(correlation)
            pmf.CorrelatedNormal("y", mu, sigma, correlation_time=tau, dt=record().dt, observed=measured)
    return model


def unconstrained(theta, sigma, correlation=None):
    """Flat point of a model of `declare`."""
    z = [*theta, logit(sigma / LARGEST_SIGMA)]
    return np.array(z if correlation is None else [*z, logit(correlation)])
