"""diffrax (optional): an adaptive method of fifth order, `vmap` over particles."""

from benchmarks.peers.population import chain_rates, mean_squares

TOLERANCE = 1e-8  # relative; absolute of metres and metres per second


def prepare(population):
    """Return a call that evaluates e_j of nonlinear chains. ImportError without diffrax."""
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    case = population.case
    rates = chain_rates(population.structure.family, jnp)
    mass, springs, rayleigh, _, values = map(jnp.asarray, population.parameters)
    times = jnp.arange(case.observed.shape[1]) * case.step
    ground = jnp.asarray(case.fine_acceleration)

    def at(t, y, given):
        return rates(*y, jnp.interp(t, times, ground), mass[0], given[0], rayleigh[0], given[1])

    controller = diffrax.PIDController(rtol=TOLERANCE, atol=1e-2 * TOLERANCE, dtmax=case.step)

    @jax.jit
    @jax.vmap
    def histories(stiffness, values):
        given, rest = (stiffness, values), (jnp.zeros(case.n_dof),) * 3
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(at),
            diffrax.Tsit5(),
            times[0],
            times[-1],
            case.step / 10.0,
            rest,
            args=given,
            saveat=diffrax.SaveAt(ts=times),
            stepsize_controller=controller,
            max_steps=None,
        ).ys
        own = jax.vmap(lambda t, y: at(t, y, given)[1])(times, found) + ground[:, None]
        return own[:, case.sensors].T

    of_each = jnp.broadcast_to(values, (len(springs), *values.shape[1:]))
    return lambda: mean_squares(histories(springs, of_each), case)
