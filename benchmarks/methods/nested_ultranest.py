"""UltraNest (optional): nested sampling with certified bounds, 400 live points, its defaults."""

import numpy as np

from benchmarks.methods.result import Result, equally_weighted
from benchmarks.problem import NAMES, CountedLikelihood, from_unit_cube


def method(problem, seed):
    """One run with the scalar likelihood."""
    from ultranest import ReactiveNestedSampler

    np.random.seed(seed)  # UltraNest draws from NumPy's global generator
    likelihood = CountedLikelihood(problem)
    sampler = ReactiveNestedSampler(list(NAMES), likelihood, from_unit_cube)
    found = sampler.run(show_status=False, viz_callback=False)
    weighted = found["weighted_samples"]
    draws = equally_weighted(weighted["points"], weighted["weights"], np.random.default_rng(seed))
    return Result(draws[:, 0], draws[:, 1], likelihood.calls, found["logz"])
