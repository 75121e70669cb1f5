"""BlackJAX (optional): the sampler of `benchmarks.methods.smc_blackjax` for a PyMC model compiled by JAX."""

import functools

import numpy as np

from benchmarks.methods.smc_blackjax import run, tempered
from benchmarks.problem import DRAWS
from benchmarks.samplers.nested import IMPOSSIBLE, density_of
from benchmarks.samplers.run import tree


@functools.lru_cache(maxsize=2)
def compiled(model):
    """The sampler of a model."""
    import jax
    import jax.numpy as jnp
    from pymc.pytensorf import join_nonshared_inputs
    from pymc.sampling.jax import get_jaxified_graph

    jax.config.update("jax_enable_x64", True)
    point = model.initial_point()
    likelihood = model.logp(vars=[*model.observed_RVs, *model.potentials])
    densities, flat = join_nonshared_inputs(
        point, [model.logp(vars=model.free_RVs), likelihood], model.value_vars
    )
    both = get_jaxified_graph([flat], densities)

    def density(number):
        def finite(x):
            value = both(x)[number]
            return jnp.where(jnp.isfinite(value), value, IMPOSSIBLE)

        return finite

    return tempered(density(0), density(1), np.ones(sum(np.size(value) for value in point.values())))


def sample(model, seed):
    """One run."""
    density, rng = density_of(model), np.random.default_rng(seed)
    particles = density.from_unit_cube(rng.random((DRAWS, density.n_dim)))
    draws, evaluations, evidence = run(compiled(model), particles, seed, rng)
    return tree(density.parameters(draws), evaluations, evidence)
