"""NumPyro (optional): NUTS on the JAX model, one chain of 500 + 1000 draws.

Its evaluations are leapfrog steps, warm-up included: each is a log-likelihood with its gradient. NumPyro
counts the steps of a warm-up only if it runs by itself, which compiles anew each time: those of one warm-up,
counted apart and not timed, stand for all.
"""

import functools
import time

import numpy as np

from benchmarks.methods.result import Result
from benchmarks.problem import DRAWS, LOWER, UPPER

WARM_UP = 500
COUNT = ("num_steps",)


def declare(problem):
    """The sampler, which compiles at its first run and keeps what it compiled."""
    import numpyro
    from numpyro import distributions as dist
    from numpyro.infer import MCMC, NUTS

    from benchmarks.jax_model import log_likelihood

    likelihood = log_likelihood(problem)

    def model():
        theta = numpyro.sample("theta", dist.Uniform(LOWER[0], UPPER[0]))
        sigma = numpyro.sample("sigma", dist.Uniform(LOWER[1], UPPER[1]))
        numpyro.factor("TN", likelihood(theta, sigma))

    return MCMC(NUTS(model), num_warmup=WARM_UP, num_samples=DRAWS, progress_bar=False)


compiled = functools.cache(declare)


@functools.cache
def warm_up_steps(problem):
    """Leapfrog steps of one warm-up."""
    import jax

    sampler = declare(problem)
    sampler.warmup(jax.random.key(0), collect_warmup=True, extra_fields=COUNT)
    return float(sampler.get_extra_fields()["num_steps"].sum())


def method(problem, seed):
    """One run with the JAX likelihood."""
    import jax

    sampler = compiled(problem)
    sampler.run(jax.random.key(seed), extra_fields=COUNT)
    draws = {name: np.asarray(values) for name, values in sampler.get_samples().items()}
    start = time.perf_counter()
    steps = float(sampler.get_extra_fields()["num_steps"].sum()) + warm_up_steps(problem)
    counting = time.perf_counter() - start
    return Result(draws["theta"], draws["sigma"], steps, counting=counting)
