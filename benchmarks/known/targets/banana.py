"""Bent posteriors: d / 2 independent pairs a ~ N(1, 1), b ~ N(a^2, 0.1), after Rosenbrock's function.

Uniform priors that reach seven standard deviations of a. The hybrid Rosenbrock density of Pagani, Wiegand &
Nadarajah (Scand. J. Statist. 49, 2022), whose normalisation is known.
"""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from scipy import stats

from benchmarks.known.answer import PROBABILITIES, Answer, Problem
from benchmarks.known.targets.mixtures_1d import even_nodes, quantiles

SD_B = 0.1
BOX_A, BOX_B = (-6.0, 8.0), (-5.0, 70.0)


def build(d):
    """Return the problem in d dimensions, an even number."""
    pairs = d // 2
    with pm.Model() as model:
        a = pm.Uniform("a", *BOX_A, shape=pairs)
        b = pm.Uniform("b", *BOX_B, shape=pairs)
        squares = pt.sum((a - 1.0) ** 2) + pt.sum((b - a**2) ** 2) / SD_B**2
        pm.Potential("likelihood", -0.5 * squares - pairs * np.log(2.0 * np.pi * SD_B))

    nodes, weights = even_nodes(*BOX_A, 20001)
    mass = weights * stats.norm.pdf(nodes, 1.0)

    def draws(n, rng):
        a = 1.0 + rng.standard_normal((n, pairs))
        return np.hstack([a, a**2 + SD_B * rng.standard_normal((n, pairs))])

    of_a = stats.norm.ppf(PROBABILITIES, 1.0)
    of_b = quantiles(lambda value: mass @ stats.norm.cdf(value, nodes**2, SD_B), *BOX_B)
    answer = Answer.exact(
        [*(f"a[{i}]" for i in range(pairs)), *(f"b[{i}]" for i in range(pairs))],
        np.column_stack([*[of_a] * pairs, *[of_b] * pairs]),
        -pairs * np.log(np.ptp(BOX_A) * np.ptp(BOX_B)),
    )
    return Problem(model, answer, draws=draws)
