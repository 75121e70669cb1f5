"""First-order hold of a modal oscillator by its textbook closed form, for the routes that are not ours.

q" + 2 zeta omega q' + omega^2 q = -a(t), with a linear over a step h, has the particular solution

    q_p = -(a0 + s t) / omega^2 + 2 zeta s / omega^3,    q_p' = -s / omega^2,    s = (a1 - a0) / h,

so that x(h) = Phi (x(0) - x_p(0)) + x_p(h) with the free vibration Phi (Nigam & Jennings, BSSA 59,
909-922, 1969). Underdamped modes only, and about 1e-16 / (omega h)^2 is lost by cancellation.
"""

from typing import NamedTuple

import numpy as np


class Hold(NamedTuple):
    """x[k+1] = Phi x[k] + now a[k] + after a[k+1] for x = (q, q'); absolute acceleration = out x."""

    phi: tuple  # ((q to q, q' to q), (q to q', q' to q')), each an array (modes,)
    now: tuple
    after: tuple
    out: tuple


def first_order_hold(omega, zeta, step, xp=np):
    """Return the coefficients of modes `omega` [rad/s], `zeta` [-] for steps of `step` seconds.

    `xp` is the array module, NumPy or `jax.numpy`.
    """
    damped = omega * xp.sqrt(1.0 - zeta**2)
    decay = xp.exp(-zeta * omega * step)
    sine = decay * xp.sin(damped * step) / damped
    cosine = decay * xp.cos(damped * step)
    phi = (
        (cosine + zeta * omega * sine, sine),
        (-(omega**2) * sine, cosine - zeta * omega * sine),
    )
    soft = 1.0 / omega**2
    ramp = soft / step
    lag = 2.0 * zeta * ramp / omega
    now = _from_particular(phi, (-soft - lag, ramp), (-lag, ramp))
    after = _from_particular(phi, (lag, -ramp), (lag - soft, -ramp))
    return Hold(phi, now, after, (-(omega**2), -2.0 * zeta * omega))


def _from_particular(phi, start, end):
    """x_p(h) - Phi x_p(0)."""
    return tuple(end[i] - phi[i][0] * start[0] - phi[i][1] * start[1] for i in (0, 1))
