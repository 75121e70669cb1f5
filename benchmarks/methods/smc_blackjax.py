"""BlackJAX (optional): adaptive tempered SMC on the JAX model, 1000 particles.

Ten random-walk steps a stage (its default) with the covariance of the weighted particles, scaled by
2.38^2 / d, and half the particles effective at the next temperature, as in PyMC. Three or five steps cost
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


def tempered(log_prior, log_likelihood, scales):
    """Initialiser of the sampler, and its stage, compiled at the first call.

    Both densities are functions of one particle (d,); `scales` (d,) are those of the first random-walk steps.
    """
    import blackjax
    import jax
    import jax.numpy as jnp
    from blackjax.mcmc import random_walk
    from blackjax.smc import extend_params, resampling

    kernel, d = blackjax.additive_step_random_walk.build_kernel(), len(scales)

    def step(key, state, log_density, factor):
        return kernel(key, state, log_density, random_walk.normal(factor))

    def proposal(key, state, info):
        covariance = jnp.cov(state.particles, rowvar=False, aweights=state.weights, ddof=0)
        return extend_params({"factor": 2.38 / np.sqrt(d) * jnp.linalg.cholesky(covariance)})

    sampler = blackjax.inner_kernel_tuning(
        smc_algorithm=blackjax.adaptive_tempered_smc,
        logprior_fn=log_prior,
        loglikelihood_fn=log_likelihood,
        mcmc_step_fn=step,
        mcmc_init_fn=blackjax.additive_step_random_walk.init,
        resampling_fn=resampling.systematic,
        mcmc_parameter_update_fn=proposal,
        initial_parameter_value=extend_params({"factor": jnp.diag(jnp.asarray(scales))}),
        num_mcmc_steps=STEPS,
        target_ess=TARGET,
    )
    return sampler.init, jax.jit(sampler.step)


def run(functions, particles, seed, rng):
    """Equally weighted draws from particles (n, d) of the prior, evaluations, and the log evidence."""
    import jax

    initialise, stage = functions
    state, evidence, stages = initialise(jax.numpy.asarray(particles)), 0.0, 0
    key = jax.random.key(seed)
    while float(state.sampler_state.tempering_param) < 1.0:
        key, now = jax.random.split(key)
        state, info = stage(now, state)
        evidence += float(info.log_likelihood_increment)
        stages += 1
    final = state.sampler_state
    draws = equally_weighted(np.asarray(final.particles), np.asarray(final.weights), rng)
    return draws, stages * EVALUATIONS * len(particles), evidence


@functools.cache
def compiled(problem):
    """The sampler of the JAX likelihood."""
    import jax.numpy as jnp

    from benchmarks.jax_model import log_likelihood

    likelihood = log_likelihood(problem)

    def log_prior(x):
        return jnp.where(((x > LOWER) & (x < UPPER)).all(), -jnp.log(UPPER - LOWER).sum(), -jnp.inf)

    return tempered(log_prior, lambda x: likelihood(*jnp.clip(x, LOWER, UPPER)), UPPER - LOWER)


def method(problem, seed):
    """One run with the JAX likelihood."""
    rng = np.random.default_rng(seed)
    particles = from_unit_cube(rng.random((DRAWS, 2)))
    draws, evaluations, evidence = run(compiled(problem), particles, seed, rng)
    return Result(draws[:, 0], draws[:, 1], evaluations, evidence)
