"""JAX (optional): `jax.jit` of a `lax.scan` over time, `vmap` over particles (`benchmarks.jax_model`)."""


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s).

    Raises ImportError without JAX.
    """
    import jax
    import numpy as np

    from benchmarks.jax_model import discrepancies

    ground, observed, sensors = case.fine_acceleration, case.observed, case.sensors

    @jax.jit
    @jax.vmap
    def population(stiffness):
        return discrepancies(stiffness, ground, observed, sensors, case.step)

    return lambda: np.asarray(population(case.stiffness))
