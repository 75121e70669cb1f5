"""Posteriors of TN, EXP and ABC of many data sets from one pool of responses.

The likelihoods depend on the data through S = sum_j e_j alone, which is a matrix product for all data sets.
The scale sigma is uniform up to its largest value and integrated in closed form; ABC accepts S up to
delta = 2 N0 sigma^2 with sigma the 90 % quantile of EXP's posterior, Eq. (16).
"""

import numpy as np
from scipy.special import gammaincc, loggamma

import pymc_features as pmf
from benchmarks.coverage.chain import LARGEST_SIGMA, PRIOR_WIDTH, record, structure
from benchmarks.coverage.intervals import Intervals, intervals, quantiles, student_draws
from pymc_features.smc.proposals.proposal import StudentMixture, StudentT

CHUNK = 200
CLAIMS = {"TN": 1, "EXP": 2}


def pool_of(covariance, size, rng):
    """Factors (size, 4) around the truth, and the log ratio of their prior and their density (size,).

    Of the springs and the damping.
    """
    n = len(covariance)
    components = [StudentT(np.ones(n), s * np.linalg.cholesky(covariance), 4.0) for s in (1.0, 2.5)]
    components.append(StudentT(np.ones(n), PRIOR_WIDTH * np.eye(n), 50.0))
    mixture = StudentMixture(components, np.array([0.45, 0.35, 0.2]))
    which = rng.choice(3, size=size, p=mixture.weights)
    draws = np.empty((size, n))
    for i, component in enumerate(components):
        mine = which == i
        draws[mine] = student_draws(component, mine.sum(), rng)
    draws = draws[(draws > 0.0).all(axis=1)]
    log_prior = -0.5 * np.sum(((draws - 1.0) / PRIOR_WIDTH) ** 2, axis=1)
    return draws, log_prior - mixture.log_density(draws)


def sums(draws, data, rate):
    """S (draw, set) of data (set, sensor, time) sampled at a rate [Hz]."""
    n_sets, n_sensors, n_times = data.shape
    flat = data.reshape(n_sets, -1)
    result = np.empty((len(draws), n_sets))
    for first in range(0, len(draws), CHUNK):
        some = draws[first : first + CHUNK]
        g = np.stack([respond(x, rate).ravel() for x in some])
        products = np.sum(g**2, axis=1)[:, None] - 2.0 * g @ flat.T + np.sum(flat**2, axis=1)
        result[first : first + CHUNK] = products / n_times
    return result


def respond(factors, rate):
    """The package's response (sensor, time) to the record."""
    return pmf.simulate(structure(factors[:-1], factors[-1]), record(rate), dt=1.0 / rate).values


def log_marginal(s, power):
    """ln of the integral of sigma^-power exp(-S / 2 sigma^2) up to the largest sigma."""
    a = 0.5 * (power - 1)
    tail = gammaincc(a, 0.5 * s / LARGEST_SIGMA**2)
    return loggamma(a) - a * np.log(0.5 * s) + np.log(np.maximum(tail, np.finfo(float).tiny))


def wide_intervals(draws, log_ratio, s, n_sensors, rng) -> dict[str, Intervals]:
    """Of TN, EXP and ABC, for one data set with sums S (draw,)."""
    weights = {kind: log_ratio + log_marginal(s, claimed * n_sensors) for kind, claimed in CLAIMS.items()}
    result = {kind: intervals(draws, w) for kind, w in weights.items()}
    shape = 0.5 * (CLAIMS["EXP"] * n_sensors - 1)
    sigma = np.sqrt(0.5 * s / rng.gamma(shape, size=len(s)))
    relative = np.exp(weights["EXP"] - weights["EXP"].max())
    delta = pmf.likelihoods.abc_tolerance(float(quantiles(sigma, relative / relative.sum(), 0.9)), n_sensors)
    result["ABC"] = intervals(draws, np.where(s <= delta, log_ratio, -np.inf))
    return result
