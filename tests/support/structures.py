"""Structures, records and measured data that many tests share."""

import numpy as np

from pymc_features import RayleighDamping, Record, SpringMassChain


def noise_record(n_times, dt=0.02, *, seed=0, scale=1.0):
    """White noise [m/s^2] as the acceleration of the base."""
    return Record(scale * np.random.default_rng(seed).normal(size=n_times), dt, name="pulse")


def three_storeys(stiffness):
    """Three unit masses on springs of `stiffness` [N/m]: 0.7 to 2.9 Hz for 100."""
    return SpringMassChain(np.ones(3), stiffness, RayleighDamping(0.1, 1e-3))


def with_first_spring(theta):
    """Three unit masses on springs of 100 N/m, the first of theta times as much."""
    return three_storeys(100.0).scale_stiffness(theta, springs=[0])


def with_noise(response, scale=1.0, seed=1):
    """Values of a response with Gaussian noise of a standard deviation `scale` [m/s^2]."""
    return response.values + scale * np.random.default_rng(seed).normal(size=response.shape)


def peak_error(actual, expected):
    """Largest difference over the largest value; NaN stays NaN."""
    return np.abs(np.asarray(actual) - np.asarray(expected)).max() / np.abs(expected).max()
