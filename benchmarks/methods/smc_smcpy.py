"""SMCPy (optional): adaptive likelihood tempering, 1000 particles, five Metropolis steps a stage.

Three or ten steps, or a target of 0.8 (its default), cost as much or more for an effective sample."""

import numpy as np
from scipy import stats

from benchmarks.methods.result import Result, equally_weighted
from benchmarks.problem import DRAWS, LOWER, NAMES, UPPER, CountedLikelihood

STEPS = 5
TARGET = 0.5  # effective share of the particles at the next temperature, as in PyMC


class Likelihood:
    """The log-likelihood in the form SMCPy asks for: (model, data, args), then points (P, 2)."""

    def __init__(self, model, data, args):
        self.likelihood = args

    def __call__(self, points):
        return np.array([self.likelihood(point) for point in points])


def method(problem, seed):
    """One run with the scalar likelihood."""
    from smcpy import AdaptiveSampler, VectorMCMC, VectorMCMCKernel

    rng = np.random.default_rng(seed)
    likelihood = CountedLikelihood(problem)
    priors = [stats.uniform(low, high - low) for low, high in zip(LOWER, UPPER, strict=True)]
    chains = VectorMCMC(None, None, priors, log_like_args=likelihood, log_like_func=Likelihood)
    sampler = AdaptiveSampler(VectorMCMCKernel(chains, NAMES, rng=rng), show_progress_bar=False)
    steps, evidence = sampler.sample(DRAWS, STEPS, target_ess=TARGET)
    last = steps[-1]
    draws = equally_weighted(last.params, np.ravel(last.weights), rng)
    return Result(draws[:, 0], draws[:, 1], likelihood.calls, float(np.ravel(evidence)[-1]))
