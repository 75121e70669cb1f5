"""Likelihoods of histories, with the arguments that each needs."""

import functools

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from scipy import stats
from scipy.special import gammaln

from pymc_features import CorrelatedNormal, ExpFeature, GammaFeature, TruncNormalFeature
from pymc_features.likelihoods import FEATURE_LIKELIHOODS, HISTORY_LIKELIHOODS
from support.graphs import PLAIN

# the law of sqrt(e), of e / sigma^2 = chi-square (degrees), and the paper's log-density written out
RMS_LAW = {TruncNormalFeature: stats.halfnorm, ExpFeature: stats.rayleigh, GammaFeature: stats.maxwell}

OTHER = {TruncNormalFeature: ExpFeature, ExpFeature: TruncNormalFeature, GammaFeature: ExpFeature}
# arguments besides mu and sigma
MORE = {CorrelatedNormal: {"correlation_time": 0.1, "dt": 0.04}, GammaFeature: {"m": 3.0}}
EVERY = pytest.mark.parametrize("likelihood", HISTORY_LIKELIHOODS)
EVERY_FEATURE = pytest.mark.parametrize("likelihood", FEATURE_LIKELIHOODS)


def declare(likelihood, *args, **kwargs):
    """The likelihood's `dist`, or by a name the variable of a model, with what it needs besides."""
    make = likelihood if isinstance(args[0] if args else None, str) else likelihood.dist
    return make(*args, **MORE.get(likelihood, {}), **kwargs)


def equation(likelihood, data, mu, sigma):
    """Summands of Eqs. (7) and (9) and of three degrees of freedom, sensor by sensor, in loops.

    Correlated errors by their covariance.
    """
    sigma = np.broadcast_to(sigma, len(data))
    values = []
    if likelihood is CorrelatedNormal:
        k = np.arange(data.shape[1])
        covariance = np.exp(-np.abs(k - k[:, None]) * 0.04 / 0.1)
        return np.array(
            [
                stats.multivariate_normal(g, s**2 * covariance).logpdf(y)
                for y, g, s in zip(data, mu, sigma, strict=True)
            ]
        )
    for y, g, s in zip(data, mu, sigma, strict=True):
        e = sum((a - b) ** 2 for a, b in zip(y, g, strict=True)) / len(y)
        if likelihood is TruncNormalFeature:
            values.append(0.5 * np.log(2 / np.pi) - np.log(s) - e / (2 * s**2))
        elif likelihood is GammaFeature:
            values.append(-1.5 * np.log(2.0) - gammaln(2.5) - 3 * np.log(s) - e / (2 * s**2))
        else:
            values.append(-np.log(2.0) - 2 * np.log(s) - e / (2 * s**2))
    return np.array(values)


@functools.cache
def compiled(likelihood, density, method, *patterns):
    """Function (mu, sigma, value) -> log-density or log-cdf, for a pattern of lengths 1 and others."""
    mu, sigma, value = (pt.tensor(shape=pattern) for pattern in patterns)
    output = getattr(pm, method)(declare(likelihood, mu, sigma, density=density), value)
    return pytensor.function([mu, sigma, value], output, mode=PLAIN)


def evaluate(likelihood, density, method, mu, sigma, value):
    """Log-density ("logp") or log-cdf ("logcdf") of the package, one value for each sensor."""
    arrays = [np.asarray(x, dtype=float) for x in (mu, sigma, value)]
    patterns = (tuple(1 if n == 1 else None for n in x.shape) for x in arrays)
    return compiled(likelihood, density, method, *patterns)(*arrays)


def random_data(seed, n_sensors=4, n_times=7):
    rng = np.random.default_rng(seed)
    mu, data = 10.0 ** rng.uniform(-3, 3) * rng.normal(size=(2, n_sensors, n_times))
    return mu, data, 10.0 ** rng.uniform(-2, 2, n_sensors)
