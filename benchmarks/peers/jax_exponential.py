"""JAX (optional): a matrix exponential, `lax.scan` over time, `vmap` over particles."""

import numpy as np


def prepare(population):
    """Return a call that evaluates e_j of linear structures by their matrices. ImportError without JAX."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    case = population.case
    n, h = case.n_dof, case.step
    ground = jnp.asarray(case.fine_acceleration)
    observed, sensors = jnp.asarray(case.observed), jnp.asarray(case.sensors)

    @jax.jit
    @jax.vmap
    def mean_squares(mass, damping, stiffness):
        a = jnp.zeros((2 * n + 2, 2 * n + 2))  # of u, v, the ground's acceleration and its slope
        a = a.at[:n, n : 2 * n].set(jnp.eye(n))
        a = a.at[n : 2 * n, :n].set(-jnp.linalg.solve(mass, stiffness))
        a = a.at[n : 2 * n, n : 2 * n].set(-jnp.linalg.solve(mass, damping))
        a = a.at[n : 2 * n, 2 * n].set(-1.0).at[2 * n, 2 * n + 1].set(1.0)
        step, output = jax.scipy.linalg.expm(a * h)[: 2 * n], a[n + sensors, : 2 * n]

        def advance(carry, inputs):
            state, total = carry
            before, now, data = inputs
            whole = jnp.concatenate([state, jnp.stack([before, (now - before) / h])])
            state = step @ whole
            return (state, total + (data - output @ state) ** 2), None

        first = jnp.zeros(2 * n), observed[:, 0] ** 2
        (_, total), _ = jax.lax.scan(advance, first, (ground[:-1], ground[1:], observed.T[1:]))
        return total / ground.size

    matrices = [jnp.asarray(matrix) for matrix in population.matrices()]
    return lambda: np.asarray(mean_squares(*matrices))
