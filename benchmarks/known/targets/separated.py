"""Separated modes of different weights: Gaussians of sd 0.5 at corners of a cube of side 10.

Between two of them lie ten standard deviations along each axis in which they differ: no chain crosses.
"""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from scipy import stats

from benchmarks.known.answer import Answer, Modes, Problem
from benchmarks.known.targets.mixtures_1d import quantiles

SD = 0.5
DISTANCE = 5.0  # of the modes from the origin, along each axis
HALF_BOX = 10.0
SIGNS = {2: [[1, 1], [-1, -1]], 4: [[1, 1], [1, -1], [-1, 1], [-1, -1]]}


def build(d, weights):
    """Return the problem in d dimensions with two or four modes; signs alternate from axis to axis."""
    weights = np.asarray(weights)
    centres = DISTANCE * np.array([np.resize(signs, d) for signs in SIGNS[len(weights)]])
    with pm.Model() as model:
        x = pm.Uniform("x", -HALF_BOX, HALF_BOX, shape=d)
        squares = pt.sum((x[None] - centres) ** 2, axis=1)
        terms = np.log(weights) - 0.5 * squares / SD**2 - 0.5 * d * np.log(2.0 * np.pi * SD**2)
        pm.Potential("likelihood", pt.logsumexp(terms))

    def which(x):
        return ((x[:, None] - centres) ** 2).sum(axis=2).argmin(axis=1)

    def draws(n, rng):
        chosen = rng.choice(len(weights), size=n, p=weights)
        return centres[chosen] + SD * rng.standard_normal((n, d))

    columns = [
        quantiles(lambda value, c=c: weights @ stats.norm.cdf(value, c, SD), -HALF_BOX, HALF_BOX)
        for c in centres.T
    ]
    answer = Answer.exact(
        [f"x[{i}]" for i in range(d)], np.column_stack(columns), -d * np.log(2.0 * HALF_BOX)
    )
    return Problem(model, answer, Modes(weights, which), draws)
