"""NumPyro (optional): NUTS on the JAX model, one chain of 500 + 1000 draws.

Its evaluations are leapfrog steps, warm-up included: each is a log-likelihood with its gradient.
"""

import functools

import numpy as np

from benchmarks.methods.result import Result
from benchmarks.problem import DRAWS, LOWER, UPPER

WARM_UP = 500


@functools.cache
def compiled(problem):
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


def method(problem, seed):
    """One run with the JAX likelihood."""
    import jax

    sampler = compiled(problem)
    sampler.warmup(jax.random.key(seed), collect_warmup=True, extra_fields=("num_steps",))
    steps = float(sampler.get_extra_fields()["num_steps"].sum())
    sampler.run(sampler.post_warmup_state.rng_key, extra_fields=("num_steps",))
    steps += float(sampler.get_extra_fields()["num_steps"].sum())
    draws = {name: np.asarray(values) for name, values in sampler.get_samples().items()}
    return Result(draws["theta"], draws["sigma"], steps)
