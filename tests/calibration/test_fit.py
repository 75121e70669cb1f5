"""The climb to the maximum of a likelihood."""

import numpy as np
import pytest

from pymc_features.calibration.fit import climb_likelihood, log_likelihood

TIME = 0.02 * np.arange(500)


def ringing(frequency, ratio):
    """Free vibration (time,) of one natural frequency [Hz] and damping ratio."""
    omega = 2.0 * np.pi * frequency
    return np.exp(-ratio * omega * TIME) * np.sin(omega * TIME)


class Ringing:
    """Predictions of a ringing with another one beside it that the model does not know.

    That makes second derivatives count: they change the curvature by a factor up to five.
    """

    names, steps = ["y"], [0.02]

    def __init__(self, seed, claimed):
        rng = np.random.default_rng(seed)
        beside = np.sin(2.0 * np.pi * rng.uniform(2.9, 3.1) * TIME + rng.uniform(0.0, 6.0))
        self.observed = (ringing(3.0, 0.004) + rng.uniform(0.3, 1.2) * beside)[None]
        self.claimed, self.count = claimed, 0

    def __call__(self, z):
        self.count += 1
        frequency, ratio, sigma = np.exp(z)
        scale = np.full(self.observed.shape, sigma * np.sqrt(TIME.size / self.claimed))
        mu = ringing(frequency, ratio)[None]
        return [[mu, self.observed, scale, np.log([sigma]), np.array([self.claimed]), np.array([np.inf])]]


@pytest.mark.parametrize("seed", [0, 3, 6, 8, 9, 10, 12, 13])
def test_the_maximum_is_found_where_residuals_are_large(seed):
    """From two starts, for likelihoods that claim 2 and 500 observations, the same to a hundredth of a width.

    Reference: no point nearby is more likely.
    """
    found = []
    for claimed, start in ((2.0, (3.01, 0.01, 0.5)), (2.0, (2.99, 0.002, 1.0)), (500.0, (3.0, 0.005, 0.5))):
        predictions = Ringing(seed, claimed)
        fit = climb_likelihood(predictions, np.log(start))
        found.append(fit.z)
        assert fit.n_evaluations == predictions.count < 200
    width = np.sqrt(np.diag(np.linalg.inv(fit.information)))
    np.testing.assert_allclose(found / width, np.broadcast_to(fit.z / width, (3, 3)), atol=0.01)
    best = log_likelihood(predictions(fit.z))
    steps = 0.1 * width * np.random.default_rng(0).standard_normal((50, 3))
    assert all(log_likelihood(predictions(fit.z + step)) < best for step in steps)
