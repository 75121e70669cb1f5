"""Heavy tails: a multivariate Student-t with 2.5 degrees of freedom, uniform prior on (-50, 50).

x = z / sqrt(g) with g ~ Gamma(nu / 2, nu / 2); given g the x_i are independent, and the box cuts each of them
by itself: all answers are integrals over ln g.
"""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from scipy import special, stats

from benchmarks.known.answer import Answer, Problem
from benchmarks.known.targets.mixtures_1d import even_nodes, quantiles

DEGREES = 2.5
HALF_BOX = 50.0


def build(d):
    """Return the problem in d dimensions."""
    constant = special.gammaln(0.5 * (DEGREES + d)) - special.gammaln(0.5 * DEGREES)
    constant -= 0.5 * d * np.log(DEGREES * np.pi)
    with pm.Model() as model:
        x = pm.Uniform("x", -HALF_BOX, HALF_BOX, shape=d)
        pm.Potential("likelihood", constant - 0.5 * (DEGREES + d) * pt.log1p(pt.sum(x**2) / DEGREES))

    log_g, weights = even_nodes(-30.0, 5.0, 20001)
    g, root = np.exp(log_g), np.exp(0.5 * log_g)
    inside = special.erf(HALF_BOX * root / np.sqrt(2.0))
    mass = weights * g * stats.gamma.pdf(g, 0.5 * DEGREES, scale=2.0 / DEGREES) * inside**d
    z = mass.sum()
    mass_of_one = mass / inside / z

    def cdf(value):
        return mass_of_one @ (stats.norm.cdf(value * root) - stats.norm.cdf(-HALF_BOX * root))

    def draws(n, rng):
        x = np.empty((0, d))
        while len(x) < n:
            scale = np.sqrt(rng.chisquare(DEGREES, 2 * n) / DEGREES)
            more = rng.standard_normal((2 * n, d)) / scale[:, None]
            x = np.concatenate([x, more[(np.abs(more) < HALF_BOX).all(axis=1)]])
        return x[:n]

    of_one = quantiles(cdf, -HALF_BOX, HALF_BOX)
    answer = Answer.exact(
        [f"x[{i}]" for i in range(d)],
        np.repeat(of_one[:, None], d, axis=1),
        np.log(z) - d * np.log(2.0 * HALF_BOX),
    )
    return Problem(model, answer, draws=draws)
