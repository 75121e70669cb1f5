"""The recursion as a scan over the output samples: response, and discrepancy without its history."""

import jax.numpy as jnp
import numpy as np
from jax import lax

from pymc_features.ops.jax_dispatch.modes import Modes
from pymc_features.simulators.oscillators.fast_modes import N_ORDERS

BLOCK = 64  # samples whose modes are kept at a time, for matrix products instead of one product each


class Sampling:
    """The ground acceleration at the steps of the recursion, in blocks of samples, zero behind the end.

    `record` are the prepared acceleration and its own values, as of `Excitation`.

    `now` and `after` (blocks, BLOCK, stride): at the beginning and the end of the steps behind each sample;
    `at` (blocks, BLOCK, 5) at the sample, with four derivatives, zero of straight lines; `there` (blocks,
    BLOCK, 1) is 1 where there is one, 0 behind the end.
    """

    def __init__(self, record, dt, substeps, stride):
        acceleration, direct = record
        n = acceleration.shape[0]
        self.total = ((n - 1) * substeps) // stride + 1
        i, part = np.divmod(np.arange((self.total - 1) * stride + 1), substeps)
        ahead = np.minimum(i + 1, n - 1)
        fine = acceleration[i] + part / substeps * (acceleration[ahead] - acceleration[i])
        self.now = self.blocks(fine[:-1].reshape(-1, stride))
        self.after = self.blocks(fine[1:].reshape(-1, stride))
        lines = jnp.zeros((self.total, N_ORDERS)).at[:, 0].set(fine[::stride])
        self.at = self.blocks(direct[:, 0].T if direct.size else lines)
        self.there = self.blocks(np.ones((self.total, 1)))
        self.duration = self.total * stride * dt / substeps

    def blocks(self, rows):
        """Rows (u or less, ...) as (blocks, BLOCK, ...), filled up with zeros."""
        n = -(-self.total // BLOCK)
        filled = jnp.zeros((n * BLOCK, *rows.shape[1:])).at[: rows.shape[0]].set(rows)
        return filled.reshape(n, BLOCK, *rows.shape[1:])


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
    """Scan over the blocks: `visit(carry, states, ground, there, data)` returns carry and what is kept.

    `states`: q, q' and, with derivatives, z, z', each (BLOCK, m), at the samples of a block; `data` (u, s).
    """
    rest = jnp.zeros(modes.n_modes)
    state = (rest,) * (4 if derivatives else 2)

    def sample(state, ground):
        return advance(modes, state, *ground, derivatives), state

    def block(both, x):
        carry, state = both
        at, there, now, after, datum = x
        state, states = lax.scan(sample, state, (now, after))
        carry, kept = visit(carry, states, at, there, datum)
        return (carry, state), kept

    xs = (sampling.at, sampling.there, sampling.now, sampling.after, sampling.blocks(data))
    (carry, _), kept = lax.scan(block, (carry, state), xs)
    return carry, kept


def sensor_output(op, modes, sensors):
    """Function of (states, ground (BLOCK, 5)): the response (BLOCK, s) at the sensors."""
    m = modes.n_modes
    shapes = modes.shapes[sensors][:, :m] * modes.participation[:m]
    feed = 1.0 if op.quantity == "absolute_acceleration" else 0.0
    return lambda states, ground: modes.outputs(*states[:2], ground) @ shapes.T + feed * ground[:, :1]


def response(op, static, parameters, record, dt, sensors):
    """y (s, u), Eqs. (17)-(24)."""
    substeps, stride, n_modes = static
    modes = Modes(op, parameters, dt / substeps, n_modes, record[1])
    sampling = Sampling(record, dt, substeps, stride)
    output = sensor_output(op, modes, sensors)
    nothing = jnp.zeros((sampling.total, 1))
    _, history = march(
        modes, sampling, lambda carry, states, at, *_: (carry, output(states, at)), 0.0, nothing
    )
    history = history.reshape(-1, sensors.shape[0])[: sampling.total]
    return jnp.where(modes.valid, history.T, jnp.nan)


def march_misfit(inputs, begin, add):
    """Sum over the misfit; returns the sums, how many samples they are of, and if there is a structure.

    `inputs` are those of `discrepancy`; `begin(first)` makes the sums of none from the first misfit (s,), and
    `add(sums, misfit, there, data)` adds a block (BLOCK, s), `there` (BLOCK, 1) being 0 behind the end.
    """
    op, (substeps, stride, n_modes), parameters, record, dt, sensors, observed = inputs
    modes = Modes(op, parameters, dt / substeps, n_modes, record[1])
    sampling = Sampling(record, dt, substeps, stride)
    output = sensor_output(op, modes, sensors)
    if observed.shape != (sensors.shape[0], sampling.total):
        raise ValueError("`observed` must have the shape (sensor, time) of the response")

    def visit(sums, states, at, there, data):
        return add(sums, data - output(states, at), there, data), None

    rest = jnp.zeros((1, n_modes))
    first = observed[:, 0] - output((rest, rest), sampling.at[0, :1])[0]
    sums, _ = march(modes, sampling, visit, begin(first), observed.T)
    return sums, sampling.total, modes.valid


def discrepancy(*inputs):
    """e (s,), Eq. (3); the sum over the samples that were measured, NaN in the data being gaps."""

    def add(errors, misfit, there, data):
        return errors + (there * jnp.where(jnp.isnan(data), 0.0, misfit) ** 2).sum(axis=0)

    errors, total, valid = march_misfit(inputs, jnp.zeros_like, add)
    return jnp.where(valid, errors / total, jnp.nan)


def misfit_statistics(*inputs):
    """Statistics (s, 4) of the misfit; see `ops.comparison`."""

    def add(sums, misfit, there, data):
        squares, increments, first, last = sums
        steps = jnp.diff(misfit, axis=0, prepend=last[None])
        last = misfit[there.sum().astype(int) - 1]
        squares = squares + (there * misfit**2).sum(axis=0)
        return squares, increments + (there * steps**2).sum(axis=0), first, last

    def begin(first):
        return jnp.zeros_like(first), jnp.zeros_like(first), first, first

    (squares, increments, *ends), total, valid = march_misfit(inputs, begin, add)
    return jnp.where(valid, jnp.stack([squares / total, increments / total, *ends], axis=-1), jnp.nan)
