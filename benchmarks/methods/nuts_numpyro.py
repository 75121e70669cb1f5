"""NumPyro (optional): NUTS on the JAX model, one chain of 500 + 1000 draws.

Its evaluations are leapfrog steps, warm-up included: each is a log-likelihood with its gradient.
"""

import functools
import time

import numpy as np

from benchmarks.methods.result import Result
from benchmarks.problem import DRAWS, LOWER, UPPER

WARM_UP = 500


@functools.cache
def compiled(problem):
    """A compiled sampler and the seconds it took: the first run less the second."""
    import jax
    import numpyro
    from numpyro import distributions as dist
    from numpyro.infer import MCMC, NUTS

    from benchmarks.jax_model import log_likelihood

    likelihood = log_likelihood(problem)

    def model():
        theta = numpyro.sample("theta", dist.Uniform(LOWER[0], UPPER[0]))
        sigma = numpyro.sample("sigma", dist.Uniform(LOWER[1], UPPER[1]))
        numpyro.factor("TN", likelihood(theta, sigma))

    sampler = MCMC(NUTS(model), num_warmup=WARM_UP, num_samples=DRAWS, progress_bar=False)
    times = [time.perf_counter()]
    for _ in range(2):
        run(sampler, jax.random.key(0))
        times.append(time.perf_counter())
    return sampler, max(0.0, 2.0 * times[1] - times[0] - times[2])


def run(sampler, key):
    """Warm up and sample; return the draws and the leapfrog steps of both."""
    sampler.warmup(key, collect_warmup=True, extra_fields=("num_steps",))
    steps = float(sampler.get_extra_fields()["num_steps"].sum())
    sampler.run(sampler.post_warmup_state.rng_key, extra_fields=("num_steps",))
    draws = {name: np.asarray(values) for name, values in sampler.get_samples().items()}
    return draws, steps + float(sampler.get_extra_fields()["num_steps"].sum())


def method(problem, seed):
    """One run with the JAX likelihood."""
    import jax

    sampler, set_up = compiled(problem)
    start = time.perf_counter()
    draws, steps = run(sampler, jax.random.key(seed))
    seconds = time.perf_counter() - start
    return Result(draws["theta"], draws["sigma"], steps, set_up, seconds)
