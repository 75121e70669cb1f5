"""BlackJAX (optional): adaptive tempered SMC of a PyMC model compiled by JAX, 1000 particles.

As `benchmarks.methods.smc_blackjax`: ten random-walk steps a stage with the covariance of the weighted
particles, scaled by 2.38^2 / d, and half the particles effective at the next temperature.
"""

import functools

import numpy as np

from benchmarks.methods.result import equally_weighted
from benchmarks.methods.smc_blackjax import EVALUATIONS, STEPS, TARGET
from benchmarks.samplers.nested import density_of
from benchmarks.samplers.run import tree

PARTICLES = 1000


@functools.lru_cache(maxsize=2)
def compiled(model):
    """Initialiser of the sampler and its stage, compiled at the first call."""
    import blackjax
    import jax
    import jax.numpy as jnp
    from blackjax.mcmc import random_walk
    from blackjax.smc import extend_params, resampling
    from pymc.pytensorf import join_nonshared_inputs
    from pymc.sampling.jax import get_jaxified_graph

    point = model.initial_point()
    likelihood = model.logp(vars=[*model.observed_RVs, *model.potentials])
    densities, flat = join_nonshared_inputs(
        point, [model.logp(vars=model.free_RVs), likelihood], model.value_vars
    )
    both = get_jaxified_graph([flat], densities)
    kernel = blackjax.additive_step_random_walk.build_kernel()
    d = sum(np.size(value) for value in point.values())

    def finite(value):
        return jnp.where(jnp.isfinite(value), value, -1e300)

    def step(key, state, log_density, factor):
        return kernel(key, state, log_density, random_walk.normal(factor))

    def proposal(key, state, info):
        covariance = jnp.cov(state.particles, rowvar=False, aweights=state.weights, ddof=0)
        factor = jnp.linalg.cholesky(jnp.atleast_2d(covariance) + 1e-12 * jnp.eye(d))
        return extend_params({"factor": 2.38 / jnp.sqrt(1.0 * d) * factor})

    sampler = blackjax.inner_kernel_tuning(
        smc_algorithm=blackjax.adaptive_tempered_smc,
        logprior_fn=lambda x: finite(both(x)[0]),
        loglikelihood_fn=lambda x: finite(both(x)[1]),
        mcmc_step_fn=step,
        mcmc_init_fn=blackjax.additive_step_random_walk.init,
        resampling_fn=resampling.systematic,
        mcmc_parameter_update_fn=proposal,
        initial_parameter_value=extend_params({"factor": jnp.eye(d)}),
        num_mcmc_steps=STEPS,
        target_ess=TARGET,
    )
    return sampler.init, jax.jit(sampler.step)


def sample(model, seed):
    """One run."""
    import jax

    jax.config.update("jax_enable_x64", True)
    initialise, stage = compiled(model)
    density, rng = density_of(model), np.random.default_rng(seed)
    particles = density.from_unit_cube(rng.random((PARTICLES, density.n_dim)))
    state, evidence, stages, key = initialise(jax.numpy.asarray(particles)), 0.0, 0, jax.random.key(seed)
    while float(state.sampler_state.tempering_param) < 1.0:
        key, now = jax.random.split(key)
        state, info = stage(now, state)
        evidence += float(info.log_likelihood_increment)
        stages += 1
    final = state.sampler_state
    draws = equally_weighted(np.asarray(final.particles), np.asarray(final.weights), rng)
    return tree(density.parameters(draws), stages * EVALUATIONS * PARTICLES, evidence)
