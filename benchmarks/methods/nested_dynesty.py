"""dynesty (optional): dynamic nested sampling, its defaults."""

import numpy as np

from benchmarks.methods.result import Result, equally_weighted
from benchmarks.problem import CountedLikelihood, from_unit_cube


def method(problem, seed):
    """One run with the scalar likelihood."""
    from dynesty import DynamicNestedSampler

    rng = np.random.default_rng(seed)
    likelihood = CountedLikelihood(problem)
    sampler = DynamicNestedSampler(likelihood, from_unit_cube, 2, rstate=rng)
    sampler.run_nested(print_progress=False)
    found = sampler.results
    draws = equally_weighted(found.samples, found.importance_weights(), rng)
    return Result(draws[:, 0], draws[:, 1], likelihood.calls, found.logz[-1])
