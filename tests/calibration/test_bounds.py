"""Calibrated intervals where the prior ends near to the likelihood's maximum: coverage, shape, words."""

import json

import numpy as np
import pymc as pm
import pytest
import xarray as xr
from scipy.special import expit
from scipy.stats import kstest, norm, truncnorm

import pymc_features as pmf
from benchmarks import truth
from benchmarks.coverage.bounds import LOWEST, PLACES, bounded, coverage, declare, exact, fitted, true_sd
from benchmarks.coverage.errors import LEVEL, measurements
from pymc_features.calibration.maxima import climb_likelihood
from pymc_features.calibration.residuals import Predictions, bounds_of
from pymc_features.calibration.sandwich import Peak
from pymc_features.exceptions import CalibrationWarning
from pymc_features.inference.parameters import Unconstrained, to_unconstrained

SETTINGS = {"chains": 2, "random_seed": 1, "progressbar": False}


@pytest.mark.statistical
@pytest.mark.slow
@pytest.mark.parametrize("place", ["at it", "0 to 4 sds within"])
def test_coverage_at_a_bound(place):
    """Of 100 data sets 82 to 99 % hold the truth: where 95 % do, a false alarm is one in 150."""
    inside, _ = coverage(PLACES[place], 100)
    assert 0.82 < inside.mean() < 0.995


@pytest.mark.slow
def test_a_truth_outside_the_prior():
    """The interval hugs the bound, one to five times as wide as that of NORM, at three sds outside."""
    upper = 1.0 - 3.0 * true_sd()
    for seed in range(10):
        low, high = bounded(seed, upper).interval
        assert high == pytest.approx(upper, abs=1e-9) and upper - low < 4.0 * true_sd()
    _, wider = coverage(-3.0, 20)
    assert 1.0 < np.median(wider) < 5.0


def test_nothing_jumps_when_the_maximum_reaches_the_bound():
    """The mean of the normal distribution behind the interval, for bounds on both sides of the maximum."""
    fit = fitted(0, 2.0).fit
    maximum = LOWEST + 1.5 * expit(fit.z[0])
    for offset in (-0.5, -0.01, 0.01, 0.5):
        upper = maximum + offset * true_sd()
        peak = fitted(0, upper)
        assert peak.fit.coordinates.near[0]
        assert LOWEST + (upper - LOWEST) * peak.free[0] == pytest.approx(maximum, abs=0.05 * true_sd())
        assert (peak.fit.pushing[0] > 0) == (offset < 0)


def posterior(**values):
    """A DataTree with a posterior of a single draw."""
    dims = "chain", "draw", "i"
    draws = {name: (dims[: 2 + np.ndim(x)], np.asarray(x)[None, None]) for name, x in values.items()}
    return xr.DataTree.from_dict({"posterior": xr.Dataset(draws)})


@pytest.mark.slow
@pytest.mark.parametrize("inside", [-3.0, 0.0])
def test_calibrate_draws_what_the_bound_leaves_of_a_normal_distribution(inside):
    """At a false-alarm rate of 1e-3, thinned. Control: one without the bound is refused."""
    model, _ = declare()
    upper = 1.0 + inside * true_sd()
    peak = fitted(1, upper)
    start = posterior(first=upper - 1e-3, others=[1.0, 1.0], sigma=0.15)
    idata = pmf.calibrate(start, model=model, draws=1000, **SETTINGS)
    x = idata["posterior"]["first"].values[:, ::4].ravel()
    sd, free = (upper - LOWEST) * peak.deviations[0], LOWEST + (upper - LOWEST) * peak.free[0]
    expected = truncnorm((LOWEST - free) / sd, (upper - free) / sd, free, sd)
    assert kstest(x, expected.cdf).pvalue > 1e-3
    assert kstest(x, norm(free, sd).cdf).pvalue < 1e-3
    table = json.loads(idata.attrs["calibration"])["parameters"]["first"]
    assert table["near_bound"] and table["bound"] == upper
    assert table["standard_deviation"] == float(idata["calibration"]["standard_deviation"][0])
    assert table["standard_deviation"] == pytest.approx(sd, rel=0.05)  # its curvature is measured anew
    assert table["room"] == pytest.approx((upper - free) / sd, abs=0.2)
    assert 0.0 < table["leverage"] < 0.3


def storeys(measured, first, second, sigma=lambda: pm.HalfNormal("sigma", 1.0)):
    """Two stiffness factors and the damping with priors of their own."""
    with pm.Model() as model:
        damping = pm.HalfNormal("damping", 2.0)
        theta = pm.math.stack([first(), second(), 1.0])
        rayleigh = pmf.RayleighDamping(0.3 * damping, 5e-4 * damping)
        chain = pmf.SpringMassChain(np.ones(3), 1200.0 * theta, rayleigh)
        mu = pmf.response(chain, pmf.Record(exact()[0].values()[0], 0.02))
        pm.Normal("y", mu, sigma(), observed=measured)
    return model


@pytest.mark.slow
def test_two_bounds_that_the_data_are_beyond():
    """Both factors stay at their bounds, and both are named with side and value; sigma takes the rest.

    The residuals of the draws are those of the maximum, to a half.
    """
    priors = lambda: pm.Uniform("first", 0.5, 0.998), lambda: pm.Uniform("second", 1.003, 1.5)
    model = storeys(measurements("white", exact()[1], 0.02, 1.0, 1), *priors)
    start = posterior(first=0.99, second=1.01, damping=1.0, sigma=0.1)
    with model, pytest.warns(CalibrationWarning) as caught:
        cal = pmf.calibrate(start, draws=200, **SETTINGS)
    words = " ".join(str(w.message) for w in caught)
    assert "the data want first above 0.998, the edge of its prior, by" in words
    assert "the data want second below 1.003, the edge of its prior, by" in words
    x = cal["posterior"].to_dataset()
    assert float(x["first"].quantile(0.05)) > 0.99 and float(x["second"].quantile(0.95)) < 1.01
    predictions = Predictions(model)
    points = to_unconstrained(model, x.isel(draw=slice(None, None, 20))).reshape(-1, 4)
    [*some, best] = (
        np.sqrt(np.mean((value.mu - value.observed) ** 2))
        for z in (*points, climb_likelihood(predictions, points[-1]).z)
        for value in predictions(z)
    )
    assert best < np.median(some) < 1.5 * best


@pytest.mark.slow
def test_draws_that_do_not_explain_the_data_are_refused():
    """A sigma whose prior is far below what any structure of the prior leaves over."""
    measured = measurements("white", exact()[1], 0.02, 1.0, 1)
    priors = lambda: pm.Uniform("first", 0.5, 0.9), lambda: 1.0, lambda: pm.Uniform("sigma", 1e-3, 0.1)
    start = posterior(first=0.89, damping=1.0, sigma=0.05)
    words = "calibrated draws must explain the data, .* times as large as their own"
    with pytest.warns(CalibrationWarning), pytest.raises(ValueError, match=words):
        pmf.calibrate(start, model=storeys(measured, *priors), draws=100, **SETTINGS)


def test_a_positive_parameter_that_wants_to_vanish():
    """Damping of a structure without: its maximum is at zero, on its own scale, and the climb gets there."""
    undamped = truth.chain_matrices(np.ones(3), np.full(3, 1200.0), (0.0, 0.0))
    response = truth.response(undamped, exact()[0])["absolute_acceleration"]
    measured = measurements("white", response, 0.02, 1.0, 3)
    priors = [lambda n=n: pm.Normal(n, 1.0, 0.2) for n in ("first", "second")]
    predictions = Predictions(storeys(measured, *priors))
    level = np.log(LEVEL * np.sqrt(np.mean(response**2)))
    for damping in (0.03, 0.3):
        peak = Peak.at(climb_likelihood(predictions, np.array([np.log(damping), 1.0, 1.0, level])))
        peak = Peak.at(peak.fit.measured_from_bounds(peak.near_bounds()))
        coordinates = peak.fit.coordinates
        assert coordinates.near.tolist() == [True, False, False, False]
        assert np.exp(peak.fit.z[0]) < 3.0 * peak.deviations[0] * np.exp(coordinates.origin[0]) < 0.05
        np.testing.assert_allclose(peak.fit.w[1:3], 1.0, atol=5.0 * peak.deviations[1])


def test_bounds_of_priors():
    """Those of each kind, one of which depends on another parameter, as that is at the point."""
    with pm.Model() as model:
        high = pm.HalfNormal("high")
        pm.Uniform("two", [0.0, 1.0], [2.0, 3.0])
        pm.TruncatedNormal("lower", 0.0, 1.0, lower=-1.0)
        pm.TruncatedNormal("upper", 0.0, 1.0, upper=4.0)
        pm.Beta("unit", 1.0, 2.0)
        pm.Normal("none")
        pm.Dirichlet("shares", np.ones(3))
        pm.Uniform("depends", 0.0, high)
    space = Unconstrained(model)
    low, high = bounds_of(model, space)(space.point | {"high_log__": np.log(5.0)})
    inf = np.inf
    np.testing.assert_allclose(low, [0.0, 0.0, 1.0, -1.0, -inf, 0.0, -inf, -inf, -inf, 0.0])
    np.testing.assert_allclose(high, [inf, 2.0, 3.0, inf, 4.0, 1.0, inf, inf, inf, 5.0])
