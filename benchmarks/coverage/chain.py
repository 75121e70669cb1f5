"""The structure, its models, and its truth: all factors are one.

The base moves as `benchmarks.truth` says, and the data are its response, not the package's.
"""

from functools import cache

import numpy as np
import pymc as pm
from scipy.special import logit

import pymc_features as pmf
from benchmarks import truth
from pymc_features.study import paper

RATES = (50.0, 100.0)  # Hz
DURATION = 30.0  # s
N_FACTORS, N_STOREYS = 3, paper.N_STOREYS
PRIOR_WIDTH = 0.25  # standard deviation of a factor
LARGEST_SIGMA = 5.0  # m/s^2


@cache
def moved(rate, duration=DURATION, seed=1):
    """Motion of the base, which is on its way at both ends."""
    return truth.motion(rate, duration, seed, ends="moving")


@cache
def record(rate):
    """Its samples."""
    return record_of(moved(rate))


def record_of(motion):
    """Samples of a motion."""
    return pmf.Record(motion.values()[0], 1.0 / motion.rate)


def structure(factors, damping=1.0):
    """The chain with factors of its lowest springs, and of its damping."""
    n = factors.type.shape[0] if hasattr(factors, "type") else len(factors)
    chain = paper.chain()
    pair = damping * chain.damping.alpha, damping * chain.damping.beta
    chain = pmf.SpringMassChain(chain.mass, chain.stiffness, pmf.RayleighDamping(*pair))
    return chain.scale_stiffness(factors, springs=list(range(n)))


def matrices(damping=1.0):
    """Those of the true chain, but for a factor of its damping, without the package."""
    pair = damping * paper.DAMPING.alpha, damping * paper.DAMPING.beta
    return truth.chain_matrices(np.full(N_STOREYS, paper.MASS), np.full(N_STOREYS, paper.STIFFNESS), pair)


@cache
def true_response(rate):
    """Floor accelerations (sensor, time) [m/s^2] at the samples."""
    return truth.response(matrices(), moved(rate))["absolute_acceleration"]


def declare(kind, rate, n_springs=N_FACTORS):
    """NORM or CN with theta, sigma (and the correlation), and the data `measured`, which can be changed.

    Theta (n_springs + 1,) are the factors of springs, and of the damping.
    """
    dt = 1.0 / rate
    with pm.Model() as model:
        theta = pm.Normal("theta", 1.0, PRIOR_WIDTH, shape=n_springs + 1)
        sigma = pm.Uniform("sigma", 0.0, LARGEST_SIGMA)
        measured = pm.Data("measured", true_response(rate))
        mu = pmf.response(structure(theta[:n_springs], theta[n_springs]), record(rate), dt=dt)
        if kind == "NORM":
            pm.Normal("y", mu, sigma, observed=measured)
        else:
            correlation = pm.Uniform("correlation", 0.0, 1.0)  # of neighbouring samples
            tau = -dt / pm.math.log(correlation)
            pmf.CorrelatedNormal("y", mu, sigma, correlation_time=tau, dt=dt, observed=measured)
    return model


def unconstrained(theta, sigma, correlation=None):
    """Flat point of a model of `declare`."""
    z = [*theta, logit(sigma / LARGEST_SIGMA)]
    return np.array(z if correlation is None else [*z, logit(correlation)])
