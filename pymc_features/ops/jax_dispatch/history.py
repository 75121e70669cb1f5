"""The recursion as a scan over the output samples: response, and discrepancy without its history."""

import jax.numpy as jnp
import numpy as np
from jax import lax

from pymc_features.ops.jax_dispatch.modes import Modes


class Sampling:
    """The ground acceleration at the steps of the recursion, by output samples.

    `now` and `after` (u, stride): at the beginning and the end of the steps behind each sample; `at` (u,).
    """

    def __init__(self, acceleration, dt, substeps, stride):
        n = acceleration.shape[0]
        self.total = ((n - 1) * substeps) // stride + 1
        i, part = np.divmod(np.arange((self.total - 1) * stride + 1), substeps)
        ahead = np.minimum(i + 1, n - 1)
        fine = acceleration[i] + part / substeps * (acceleration[ahead] - acceleration[i])
        rest = jnp.zeros((1, stride))
        self.now = jnp.concatenate([fine[:-1].reshape(-1, stride), rest])
        self.after = jnp.concatenate([fine[1:].reshape(-1, stride), rest])
        self.at = fine[::stride]
        self.duration = self.total * stride * dt / substeps


def advance(modes, state, now, after, derivatives):
    """Carry (q, p) or (q, p, y, z) through the steps between two output samples."""
    qq, qp, pq, pp, qn, pn, qa, pa = modes.hold
    dqq, dqp, dpq, dpp, dqn, dpn, dqa, dpa = modes.hold_derivative

    def one(state, ground):
        a, b = ground
        q, p, *more = state
        if derivatives:
            y, z = more
            more = (
                qq * y + qp * z + dqq * q + dqp * p + dqn * a + dqa * b,
                pq * y + pp * z + dpq * q + dpp * p + dpn * a + dpa * b,
            )
        return (qq * q + qp * p + qn * a + qa * b, pq * q + pp * p + pn * a + pa * b, *more), None

    if now.shape[0] == 1:
        return one(state, (now[0], after[0]))[0]
    return lax.scan(one, state, (now, after))[0]


def march(modes, sampling, visit, carry, data, derivatives=False):
    """Scan over the output samples: `visit(carry, state, ground, data)` returns carry and what is kept."""
    rest = jnp.zeros(modes.n_modes)
    state = (rest,) * (4 if derivatives else 2)

    def sample(both, x):
        carry, state = both
        at, now, after, datum = x
        carry, kept = visit(carry, state, at, datum)
        return (carry, advance(modes, state, now, after, derivatives)), kept

    return_carry, kept = lax.scan(sample, (carry, state), (sampling.at, sampling.now, sampling.after, data))
    return return_carry[0], kept


def sensor_output(op, modes, sensors):
    """Function of (state, ground): the response at the sensors."""
    m = modes.n_modes
    shapes = modes.shapes[sensors][:, :m] * modes.participation[:m]
    feed = 1.0 if op.quantity == "absolute_acceleration" else 0.0
    return lambda state, ground: shapes @ modes.outputs(state[0], state[1], ground) + feed * ground


def response(op, static, parameters, acceleration, dt, sensors):
    """y (s, u), Eqs. (17)-(24)."""
    substeps, stride, n_modes = static
    modes = Modes(op, parameters, dt / substeps, n_modes)
    sampling = Sampling(acceleration, dt, substeps, stride)
    output = sensor_output(op, modes, sensors)
    _, history = march(
        modes, sampling, lambda carry, state, at, _: (carry, output(state, at)), 0.0, sampling.at
    )
    return jnp.where(modes.valid, history.T, jnp.nan)


def discrepancy(op, static, parameters, acceleration, dt, sensors, observed):
    """e (s,), Eq. (3)."""
    substeps, stride, n_modes = static
    modes = Modes(op, parameters, dt / substeps, n_modes)
    sampling = Sampling(acceleration, dt, substeps, stride)
    output = sensor_output(op, modes, sensors)
    if observed.shape != (sensors.shape[0], sampling.total):
        raise ValueError("`observed` must have the shape (sensor, time) of the response")

    def visit(errors, state, at, data):
        return errors + (data - output(state, at)) ** 2, None

    errors, _ = march(modes, sampling, visit, jnp.zeros(sensors.shape[0]), observed.T)
    return jnp.where(modes.valid, errors / sampling.total, jnp.nan)
