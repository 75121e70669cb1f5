"""BlackJAX (optional): adaptive tempered SMC on the JAX model, 1000 particles.

Ten random-walk steps a stage (its default) with the covariance of the weighted particles, scaled by
2.38^2 / 2, and half the particles effective at the next temperature, as in PyMC. Three or five steps cost
more for an effective sample.
"""

import functools

import numpy as np

from benchmarks.methods.result import Result, equally_weighted
from benchmarks.problem import DRAWS, LOWER, UPPER, from_unit_cube

STEPS = 10
TARGET = 0.5
# of each particle in a stage: the steps, their start, the temperature, the weights
EVALUATIONS = STEPS + 3


@functools.cache
def compiled(problem):
    """Initialiser of the sampler and its stage, compiled at the first call."""
    import blackjax
    import jax
    import jax.numpy as jnp
    from blackjax.mcmc import random_walk
    from blackjax.smc import extend_params, resampling

    from benchmarks.jax_model import log_likelihood

    likelihood = log_likelihood(problem)
    kernel = blackjax.additive_step_random_walk.build_kernel()

    def log_prior(x):
        return jnp.where(((x > LOWER) & (x < UPPER)).all(), -jnp.log(UPPER - LOWER).sum(), -jnp.inf)

    def step(key, state, log_density, factor):
        return kernel(key, state, log_density, random_walk.normal(factor))

    def proposal(key, state, info):
        covariance = jnp.cov(state.particles, rowvar=False, aweights=state.weights, ddof=0)
        return extend_params({"factor": 2.38 / jnp.sqrt(2.0) * jnp.linalg.cholesky(covariance)})

    sampler = blackjax.inner_kernel_tuning(
        smc_algorithm=blackjax.adaptive_tempered_smc,
        logprior_fn=log_prior,
        loglikelihood_fn=lambda x: likelihood(*jnp.clip(x, LOWER, UPPER)),
        mcmc_step_fn=step,
        mcmc_init_fn=blackjax.additive_step_random_walk.init,
        resampling_fn=resampling.systematic,
        mcmc_parameter_update_fn=proposal,
        initial_parameter_value=extend_params({"factor": jnp.diag(UPPER - LOWER)}),
        num_mcmc_steps=STEPS,
        target_ess=TARGET,
    )
    return sampler.init, jax.jit(sampler.step)


def method(problem, seed):
    """One run with the JAX likelihood."""
    import jax

    initialise, stage = compiled(problem)
    rng = np.random.default_rng(seed)
    state = initialise(jax.numpy.asarray(from_unit_cube(rng.random((DRAWS, 2)))))
    evidence, stages, key = 0.0, 0, jax.random.key(seed)
    while float(state.sampler_state.tempering_param) < 1.0:
        key, now = jax.random.split(key)
        state, info = stage(now, state)
        evidence += float(info.log_likelihood_increment)
        stages += 1
    final = state.sampler_state
    draws = equally_weighted(np.asarray(final.particles), np.asarray(final.weights), rng)
    return Result(draws[:, 0], draws[:, 1], stages * EVALUATIONS * DRAWS, evidence)
