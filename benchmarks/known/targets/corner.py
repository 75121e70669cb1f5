"""A peak of sd 0.001 in the unit box, two standard deviations from a corner in every coordinate."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from scipy import stats

from benchmarks.known.answer import PROBABILITIES, Answer, Problem

SD = 1e-3
CENTRE = 2.0 * SD


def build(d):
    """Return the problem in d dimensions: a product of truncated Gaussians."""
    with pm.Model() as model:
        x = pm.Uniform("x", 0.0, 1.0, shape=d)
        squares = pt.sum((x - CENTRE) ** 2) / SD**2
        pm.Potential("likelihood", -0.5 * squares - 0.5 * d * np.log(2.0 * np.pi * SD**2))

    of_one = stats.truncnorm(-CENTRE / SD, (1.0 - CENTRE) / SD, CENTRE, SD)
    answer = Answer.exact(
        [f"x[{i}]" for i in range(d)],
        np.repeat(of_one.ppf(PROBABILITIES)[:, None], d, axis=1),
        d * stats.norm.logcdf(CENTRE / SD),
    )
    return Problem(model, answer, draws=lambda n, rng: of_one.rvs((n, d), random_state=rng))
