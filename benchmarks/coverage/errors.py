"""Measurement errors (sensor, time) of one size and several kinds. A new kind is one entry of `ERRORS`."""

import numpy as np
from scipy.signal import lfilter

from pymc_features.study.paper import persistent

LEVEL = 0.05  # of the root mean square of the response
BEFORE = 2000  # samples that a filter runs before the record
COMMON_TIME = 0.1  # s, time constant of errors common to all sensors
DAMPING = 0.05  # of narrow-band errors


def white(rng, response, dt, frequency):
    """Independent."""
    return rng.standard_normal(response.shape)


def first_order(rng, shape, dt, time_constant):
    """Autoregressive of first order (sensor, time), unit variance."""
    return persistent(rng.standard_normal(shape), dt, time_constant)


def quick(rng, response, dt, frequency):
    """Persistent for 0.05 s."""
    return first_order(rng, response.shape, dt, 0.05)


def slow(rng, response, dt, frequency):
    """Persistent for 0.5 s."""
    return first_order(rng, response.shape, dt, 0.5)


def common(rng, response, dt, frequency):
    """Half of the variance persistent and shared by all sensors, the rest independent."""
    shared = first_order(rng, (1, response.shape[1]), dt, COMMON_TIME)
    return np.sqrt(0.5) * (shared + rng.standard_normal(response.shape))


def growing(rng, response, dt, frequency):
    """In proportion to the response, persistent for 0.05 s."""
    return response / np.sqrt(np.mean(response**2)) * first_order(rng, response.shape, dt, 0.05)


def narrow(rng, response, dt, frequency):
    """At the first natural frequency."""
    w = 2.0 * np.pi * frequency
    radius = np.exp(-DAMPING * w * dt)
    noise = rng.standard_normal((response.shape[0], response.shape[1] + BEFORE))
    signal = lfilter([1.0], [1.0, -2.0 * radius * np.cos(w * dt), radius**2], noise, axis=1)[:, BEFORE:]
    power = (1.0 + radius**2) / ((1.0 - radius**2) * (1.0 - 2.0 * radius**2 * np.cos(2 * w * dt) + radius**4))
    return signal / np.sqrt(power)


ERRORS = {
    "white": white,
    "AR(1), 0.05 s": quick,
    "AR(1), 0.5 s": slow,
    "common to all sensors": common,
    "growing with the response": growing,
    "narrow-band": narrow,
}


def measurements(kind, response, dt, frequency, seed):
    """The response (sensor, time) with errors of one kind."""
    size = LEVEL * np.sqrt(np.mean(response**2))
    return response + size * ERRORS[kind](np.random.default_rng(seed), response, dt, frequency)
