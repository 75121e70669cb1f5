"""What the tests of JAX share."""

import pytest


@pytest.fixture
def quick_compilation():
    """XLA without most optimisations takes half the time; one log-density of a model has them all."""
    import jax

    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)
