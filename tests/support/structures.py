"""Structures, records and measured data that many tests share."""

import numpy as np

from pymc_features import ModalDamping, RayleighDamping, SpringMassChain
from support.straight import Record


def noise_record(n_times, dt=0.02, *, seed=0, scale=1.0):
    """White noise [m/s^2] as the acceleration of the base."""
    return Record(scale * np.random.default_rng(seed).normal(size=n_times), dt, name="pulse")


def three_storeys(stiffness):
    """Three unit masses on springs of `stiffness` [N/m]: 0.7 to 2.9 Hz for 100."""
    return SpringMassChain(np.ones(3), stiffness, RayleighDamping(0.1, 1e-3))


def with_first_spring(theta):
    """Three unit masses on springs of 100 N/m, the first of theta times as much."""
    return three_storeys(100.0).scale_stiffness(theta, springs=[0])


DAMPINGS = {
    "rayleigh": lambda n: RayleighDamping(0.2, 1e-3),
    "none": lambda n: ModalDamping(0.0),
    "very light": lambda n: ModalDamping(1e-8),
    "critical": lambda n: ModalDamping(1.0),
    "over-critical": lambda n: ModalDamping(np.linspace(1.5, 4.0, n)),
    "mixed": lambda n: ModalDamping(np.linspace(0.0, 2.0, n)),
    "heavy rayleigh": lambda n: RayleighDamping(20.0, 0.05),
}


def random_chain(seed, damping="rayleigh"):
    """One to eight masses with frequencies from below 1 Hz to beyond the sampling rate."""
    rng = np.random.default_rng(seed)
    n = seed % 8 + 1
    stiffness = 10.0 ** rng.uniform(1.5, 4.5) * rng.uniform(0.2, 5.0, n)
    return SpringMassChain(rng.uniform(0.2, 5.0, n), stiffness, DAMPINGS[damping](n))


def with_noise(response, scale=1.0, seed=1):
    """Values of a response with Gaussian noise of a standard deviation `scale` [m/s^2]."""
    return response.values + scale * np.random.default_rng(seed).normal(size=response.shape)


def peak_error(actual, expected):
    """Largest difference over the largest value; NaN stays NaN."""
    return np.abs(np.asarray(actual) - np.asarray(expected)).max() / np.abs(expected).max()
