"""Neal's funnel: v ~ N(0, 3), and d - 1 parameters x_i ~ N(0, e^(v/2)), whose neck narrows by e^10.

The prior of the x_i is uniform on (-200, 200), so that tempering has a way to go; it cuts a little of the
widest part away. Given v the x_i are independent: all answers are integrals over v.
"""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from scipy import stats

from benchmarks.known.answer import Answer, Problem
from benchmarks.known.targets.mixtures_1d import even_nodes, quantiles

SD_V = 3.0
HALF_BOX = 200.0


def build(d):
    """Return the problem in d dimensions, v and d - 1 others."""
    n = d - 1
    with pm.Model() as model:
        v = pm.Normal("v", 0.0, SD_V)
        x = pm.Uniform("x", -HALF_BOX, HALF_BOX, shape=n)
        pm.Potential("likelihood", -0.5 * (pt.exp(-v) * pt.sum(x**2) + n * (v + np.log(2.0 * np.pi))))

    nodes, weights = even_nodes(-12.0 * SD_V, 12.0 * SD_V, 20001)
    sd = np.exp(0.5 * nodes)
    inside = stats.norm.cdf(HALF_BOX / sd) - stats.norm.cdf(-HALF_BOX / sd)
    mass = weights * stats.norm.pdf(nodes, scale=SD_V) * inside**n
    z = mass.sum()
    below = np.cumsum(mass) - 0.5 * mass
    mass_of_one = mass / inside / z

    def cdf_x(value):
        return mass_of_one @ (stats.norm.cdf(value / sd) - stats.norm.cdf(-HALF_BOX / sd))

    def draws(count, rng):
        v = np.interp(rng.random(count), below / z, nodes)
        limit = HALF_BOX * np.exp(-0.5 * v)[:, None]
        unit = stats.truncnorm.rvs(-limit, limit, size=(count, n), random_state=rng)
        return np.column_stack([v, unit * np.exp(0.5 * v)[:, None]])

    of_v = quantiles(lambda value: np.interp(value, nodes, below / z), nodes[0], nodes[-1])
    of_x = quantiles(cdf_x, -HALF_BOX, HALF_BOX)
    answer = Answer.exact(
        ["v", *(f"x[{i}]" for i in range(n))],
        np.column_stack([of_v, *[of_x] * n]),
        np.log(z) - n * np.log(2.0 * HALF_BOX),
    )
    return Problem(model, answer, draws=draws)
