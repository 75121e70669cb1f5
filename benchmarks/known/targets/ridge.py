"""Two parameters of which the data know the product only: theta_1 theta_2 = 1 +- 0.01.

Uniform priors on (0.1, 10). Given theta_1, theta_2 is a truncated Gaussian: all answers are integrals over
ln theta_1, and both parameters have the same marginal.
"""

import numpy as np
import pymc as pm
from scipy import stats

from benchmarks.known.answer import Answer, Problem
from benchmarks.known.targets.mixtures_1d import quantiles

SD = 0.01
LOW, HIGH = 0.1, 10.0
CELLS = 200_000


def build(d=2):
    """Return the problem; d must be 2."""
    if d != 2:
        raise ValueError(f"`d` must be 2, got {d}. The ridge lies in a plane.")
    with pm.Model() as model:
        theta = pm.Uniform("theta", LOW, HIGH, shape=2)
        pm.Potential("likelihood", -0.5 * ((theta[0] * theta[1] - 1.0) / SD) ** 2)

    edges = np.linspace(np.log(LOW), np.log(HIGH), CELLS + 1)
    first = np.exp(0.5 * (edges[1:] + edges[:-1]))
    limits = [(limit - 1.0 / first) * first / SD for limit in (LOW, HIGH)]
    # the Gaussian in theta_2 has the width SD / theta_1, and d theta_1 = theta_1 d ln theta_1
    mass = (stats.norm.cdf(limits[1]) - stats.norm.cdf(limits[0])) * (edges[1] - edges[0])
    below = np.concatenate([[0.0], np.cumsum(mass)])
    below /= below[-1]

    def draws(n, rng):
        a = np.exp(np.interp(rng.random(n), below, edges))
        cut = [(limit - 1.0 / a) * a / SD for limit in (LOW, HIGH)]
        return np.column_stack([a, (1.0 + SD * stats.truncnorm.rvs(*cut, random_state=rng)) / a])

    of_one = np.exp(quantiles(lambda value: np.interp(value, edges, below), edges[0], edges[-1]))
    log_z = np.log(mass.sum() * np.sqrt(2.0 * np.pi) * SD) - 2.0 * np.log(HIGH - LOW)
    answer = Answer.exact(["theta[0]", "theta[1]"], np.column_stack([of_one, of_one]), log_z)
    return Problem(model, answer, draws=draws)
