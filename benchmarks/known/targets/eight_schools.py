"""Eight schools (Rubin 1981), centred and not: mu ~ N(0, 5), tau ~ HalfCauchy(5).

Given tau everything is Gaussian, mu too: all answers are integrals over ln tau.
"""

import numpy as np
import pymc as pm
from scipy import stats

from benchmarks.known.answer import Answer, Problem
from benchmarks.known.targets.mixtures_1d import even_nodes, quantiles

EFFECTS = np.array([28.0, 8.0, -3.0, 7.0, -1.0, 1.0, 18.0, 12.0])
ERRORS = np.array([15.0, 10.0, 16.0, 11.0, 9.0, 11.0, 10.0, 18.0])
SCALE = 5.0  # of both priors


def given_tau(tau):
    """Mean and variance of mu (n,), and the log-density of the data, for each tau (n,)."""
    total = tau[:, None] ** 2 + ERRORS**2
    variance = 1.0 / (1.0 / SCALE**2 + (1.0 / total).sum(axis=1))
    mean = variance * (EFFECTS / total).sum(axis=1)
    at_zero = stats.norm.logpdf(EFFECTS, 0.0, np.sqrt(total)).sum(axis=1)
    return mean, variance, at_zero + 0.5 * np.log(variance / SCALE**2) + 0.5 * mean**2 / variance


def school(centred, tau):
    """Of theta_j, or of eta_j = (theta_j - mu) / tau, given mu and tau (n,): c and s in c_0 + c_1 mu +- s."""
    tau = tau[:, None]
    total = tau**2 + ERRORS**2
    if centred:
        return EFFECTS * tau**2 / total, ERRORS**2 / total, ERRORS * tau / np.sqrt(total)
    return tau * EFFECTS / total, -tau / total, ERRORS / np.sqrt(total)


def build(d=10, centred=False):
    """Return the problem: mu, tau and eight schools."""
    if d != 10:
        raise ValueError(f"`d` must be 10, got {d}. There are eight schools.")
    name = "theta" if centred else "eta"
    with pm.Model() as model:
        mu = pm.Normal("mu", 0.0, SCALE)
        tau = pm.HalfCauchy("tau", SCALE)
        effect = pm.Normal("theta", mu, tau, shape=8) if centred else mu + tau * pm.Normal("eta", shape=8)
        pm.Normal("y", effect, ERRORS, observed=EFFECTS)

    log_tau, weights = even_nodes(-20.0, 8.0, 4001)
    tau = np.exp(log_tau)
    mean, variance, log_density = given_tau(tau)
    mass = weights * tau * stats.halfcauchy.pdf(tau, scale=SCALE) * np.exp(log_density)
    z = mass.sum()
    mass /= z
    below = np.cumsum(mass) - 0.5 * mass
    constant, slope, sd = school(centred, tau)
    locations = constant + slope * mean[:, None]
    scales = np.sqrt(sd**2 + slope**2 * variance[:, None])

    def draws(n, rng):
        tau = np.exp(np.interp(rng.random(n), below, log_tau))
        mean, variance, _ = given_tau(tau)
        mu = mean + np.sqrt(variance) * rng.standard_normal(n)
        constant, slope, sd = school(centred, tau)
        schools = constant + slope * mu[:, None] + sd * rng.standard_normal((n, 8))
        return np.column_stack([mu, tau, schools])

    columns = [
        quantiles(lambda value: mass @ stats.norm.cdf(value, mean, np.sqrt(variance)), -50.0, 50.0),
        np.exp(quantiles(lambda value: np.interp(value, log_tau, below), -20.0, 8.0)),
        *(
            quantiles(lambda value, a=a, b=b: mass @ stats.norm.cdf(value, a, b), -200.0, 200.0)
            for a, b in zip(locations.T, scales.T, strict=True)
        ),
    ]
    labels = ["mu", "tau", *(f"{name}[{i}]" for i in range(8))]
    return Problem(model, Answer.exact(labels, np.column_stack(columns), np.log(z)), draws=draws)
