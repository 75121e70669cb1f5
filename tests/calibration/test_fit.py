"""The climb to the maximum of a likelihood, its curvature, and data with gaps."""

import numpy as np
import pymc as pm
import pytensor
import pytest
import xarray as xr
from scipy.signal import lfilter

from pymc_features import ExpFeature, GammaFeature, effective_samples
from pymc_features.calibration.maxima import climb_likelihood
from pymc_features.calibration.residuals import Comparison, Coordinates, log_likelihood
from pymc_features.calibration.sandwich import Peak
from pymc_features.calibration.stretched import curved

TIME = 0.02 * np.arange(500)


def ringing(frequency, ratio):
    """Free vibration (time,) of one natural frequency [Hz] and damping ratio."""
    omega = 2.0 * np.pi * frequency
    return np.exp(-ratio * omega * TIME) * np.sin(omega * TIME)


class Ringing:
    """Predictions of a ringing with another one beside it that the model does not know.

    That makes second derivatives count: they change the curvature by a factor up to five.
    """

    coordinates = Coordinates(np.zeros(3, dtype=int), np.zeros(3, dtype=bool), np.zeros(3))

    def __init__(self, seed, claimed, mixing=None):
        self.mixing = np.eye(3) if mixing is None else mixing
        rng = np.random.default_rng(seed)
        beside = np.sin(2.0 * np.pi * rng.uniform(2.9, 3.1) * TIME + rng.uniform(0.0, 6.0))
        self.observed = (ringing(3.0, 0.004) + rng.uniform(0.3, 1.2) * beside)[None]
        self.claimed, self.count = claimed, 0

    def frequencies(self, z):
        return [None]

    def __call__(self, z):
        self.count += 1
        frequency, ratio, sigma = np.exp(self.mixing @ z)
        scale = sigma * np.sqrt(TIME.size / self.claimed)
        mu = ringing(frequency, ratio)
        return [Comparison(mu, self.observed, scale, self.claimed, step=0.02).by_sensor()]


@pytest.mark.parametrize("seed", [0, 6, 9, 12])
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


@pytest.mark.parametrize("seed", [0, 9])
def test_curvature_does_not_depend_on_how_parameters_are_mixed(seed):
    """Correlated to 0.9999, they have the curvature of the uncorrelated ones.

    Control: it is not that by Gauss and Newton.
    """
    curvatures, by_gauss = [], []
    for matrix in (np.eye(3), np.eye(3) + 10.0 * np.eye(3, k=1)[[0, 2, 2]]):
        predictions = Ringing(seed, 2.0, matrix)
        fit = climb_likelihood(predictions, np.linalg.solve(matrix, np.log((3.0, 0.005, 0.5))))
        peak, _ = curved(predictions, Peak.at(fit))
        unmixed = np.linalg.inv(matrix)
        curvatures.append(unmixed.T @ peak.information @ unmixed)
        by_gauss.append(unmixed.T @ fit.information @ unmixed)
    scale = np.sqrt(np.outer(np.diag(by_gauss[0]), np.diag(by_gauss[0])))
    np.testing.assert_allclose(curvatures[1] / scale, curvatures[0] / scale, atol=0.03)
    assert np.abs((curvatures[0] - by_gauss[0]) / scale).max() > 0.1


def mean_model(data, kind=GammaFeature):
    """A constant in white noise, or what is taken for it."""
    n = (~np.isnan(data)).sum(axis=1).astype(float)
    with pm.Model() as model:
        mu, sigma = pm.Normal("mu", 0.0, 10.0) * np.ones(data.shape), pm.HalfNormal("sigma", 3.0)
        if kind is GammaFeature:
            GammaFeature("y", mu, sigma / np.sqrt(n), m=n, density="data", observed=data)
        else:
            ExpFeature("y", mu, sigma, observed=data)
    return model


@pytest.mark.slow
@pytest.mark.parametrize("kind", [GammaFeature, ExpFeature])
@pytest.mark.parametrize("phi", [0.0, 0.8])
def test_observations_of_data_with_gaps(phi, kind):
    """N_j (1 - phi) / (1 + phi) of a process of first order, to 15 % with 7,000 samples; the mean exactly."""
    rng = np.random.default_rng(1)
    data = 3.0 + lfilter([1.0], [1.0, -phi], rng.normal(size=(2, 10_000)), axis=1)
    data[0, 2000:5000], data[1, 4000:6000] = np.nan, np.nan
    n = (~np.isnan(data)).sum(axis=1)
    draw = xr.Dataset({"mu": (("chain", "draw"), [[3.0]]), "sigma": (("chain", "draw"), [[1.0]])})
    idata = xr.DataTree.from_dict({"posterior": draw})
    found = effective_samples(idata, model=mean_model(data, kind))
    np.testing.assert_allclose(found["n_eff"], n * (1.0 - phi) / (1.0 + phi), rtol=0.15)
    assert found.attrs["claimed"] == (n.sum() if kind is GammaFeature else 4)
    weights = 1.0 if kind is GammaFeature else 1.0 / n  # EXP weighs the sensors alike
    mean = np.sum(weights * np.nansum(data, axis=1)) / np.sum(weights * n)
    assert float(found["point"].sel(parameter="mu")) == pytest.approx(mean, abs=1e-4)


def test_gaps_that_leave_too_little():
    data = np.random.default_rng(1).normal(size=(2, 400))
    data[0, 100:200], data[1, 250:320] = np.nan, np.nan
    too_few = "all sensors for 60 % of the record or more, .* got 57 % in y. Compare"
    with pytest.raises(ValueError, match=too_few):
        effective_samples(mean_model(data))
    with pm.Model() as model:
        pm.Normal("y", pm.Normal("mu"), 1.0, observed=pytensor.shared(data))
    with pytest.raises(ValueError, match="data without gaps, got NaN in y. Leave them out by a feature"):
        effective_samples(model)
