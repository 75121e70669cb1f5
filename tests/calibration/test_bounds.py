"""Calibrated intervals where the prior ends near to the likelihood's maximum: coverage, shape, words.

Data by `benchmarks.truth`, errors persistent for 0.05 s.
"""

import json

import numpy as np
import pymc as pm
import pytest
import xarray as xr
from scipy.special import ndtri_exp
from scipy.stats import kstest, norm, truncnorm

import pymc_features as pmf
from benchmarks.coverage.bounds import (
    LOWEST,
    PLACES,
    bounded,
    coverage,
    declare,
    exact,
    fitted,
    true_sd,
)
from benchmarks.coverage.errors import LEVEL, measurements
from pymc_features.calibration.bounds import interval, log_share, quantiles
from pymc_features.calibration.climb import climb_likelihood
from pymc_features.calibration.comparison import log_likelihood
from pymc_features.calibration.coordinates import Coordinates, sides_of
from pymc_features.calibration.fit import Predictions
from pymc_features.calibration.peaks import Peak
from pymc_features.calibration.sandwich import sandwich
from pymc_features.exceptions import CalibrationWarning
from pymc_features.inference.parameters import Unconstrained, to_unconstrained

N_SETS = 100


@pytest.mark.statistical
@pytest.mark.slow
@pytest.mark.parametrize("place", ["at it", "2 sds within", "0 to 4 sds within"])
def test_coverage_at_a_bound(place):
    """Of 100 data sets 82 to 99 % hold the truth: where 95 % do, a false alarm is one in 150."""
    inside, _ = coverage(PLACES[place], N_SETS)
    assert 0.82 < inside.mean() < 0.995


@pytest.mark.slow
def test_a_truth_outside_the_prior():
    """The interval hugs the bound, one to five times as wide as that of NORM, at three sds outside."""
    upper = 1.0 - 3.0 * true_sd()
    for seed in range(20):
        found = bounded(seed, upper)
        low, high = found.interval
        assert high == pytest.approx(upper, abs=1e-9) and upper - low < 4.0 * true_sd()
    _, wider = coverage(-3.0, 20)
    assert 1.0 < np.median(wider) < 5.0


def test_nothing_jumps_when_the_maximum_reaches_the_bound():
    """The mean of the normal distribution behind the interval, for bounds on both sides of the maximum."""
    fit = fitted(0, 2.0).fit
    maximum = LOWEST + 1.5 * fit.coordinates.distance(fit.z)[0]
    for offset in (-0.5, -0.01, 0.01, 0.5):
        upper = maximum + offset * true_sd()
        peak = fitted(0, upper)
        assert peak.fit.coordinates.near[0]
        free = LOWEST + (upper - LOWEST) * peak.free[0]
        assert free == pytest.approx(maximum, abs=0.05 * true_sd())
        assert (peak.fit.pushing[0] > 0) == (offset < 0)


@pytest.mark.slow
@pytest.mark.parametrize("inside", [-3.0, 0.0])
def test_calibrate_draws_what_the_bound_leaves_of_a_normal_distribution(inside):
    """At a false-alarm rate of 1e-3, thinned. Control: one without the bound is refused."""
    model, _ = declare()
    upper = 1.0 + inside * true_sd()
    peak = fitted(1, upper)
    draws = {"first": 0.5 * (LOWEST + upper), "others": [1.0, 1.0], "sigma": 0.15}
    start = {name: (("chain", "draw", "i")[: 2 + np.ndim(x)], [[x]]) for name, x in draws.items()}
    start["first"] = (("chain", "draw"), [[upper - 1e-3]])
    idata = pmf.calibrate(
        posterior(start), model=model, draws=1000, chains=2, random_seed=1, progressbar=False
    )
    x = idata["posterior"]["first"].values[:, ::4].ravel()
    sd = peak.deviations[0] * (upper - LOWEST)
    free = LOWEST + (upper - LOWEST) * peak.free[0]
    expected = truncnorm((LOWEST - free) / sd, (upper - free) / sd, free, sd)
    assert kstest(x, expected.cdf).pvalue > 1e-3
    assert kstest(x, truncnorm(-9.0, 9.0, free, sd).cdf).pvalue < 1e-3
    found = idata["calibration"].to_dataset()
    table = json.loads(idata.attrs["calibration"])["parameters"]["first"]
    assert table["near_bound"] and table["bound"] == upper
    assert table["standard_deviation"] == float(found["standard_deviation"][0])
    assert table["standard_deviation"] == pytest.approx(sd, rel=0.05)  # its curvature is measured anew
    assert table["room"] == pytest.approx((upper - free) / sd, abs=0.2)
    assert 0.0 < table["leverage"] < 0.3


def posterior(variables):
    """A DataTree with a posterior."""
    return xr.DataTree.from_dict({"posterior": xr.Dataset(variables)})


def storeys(measured, first, second):
    """Two stiffness factors and the damping with priors of their own."""
    moved, _ = exact()
    record = pmf.Record(moved.values()[0], 0.02)
    with pm.Model() as model:
        damping = pm.HalfNormal("damping", 2.0)
        theta = pm.math.stack([first(), second(), 1.0])
        chain = pmf.SpringMassChain(
            np.ones(3), 1200.0 * theta, pmf.RayleighDamping(0.3 * damping, 5e-4 * damping)
        )
        pm.Normal("y", pmf.response(chain, record), pm.HalfNormal("sigma", 1.0), observed=measured)
    return model


@pytest.mark.slow
def test_two_bounds_that_the_data_are_beyond():
    """Both factors stay at their bounds, and both are named with side and value; sigma takes the rest.

    The residuals of the draws are those of the maximum, to a half.
    """
    response = exact()[1]
    measured = measurements("white", response, 0.02, 1.0, 1)
    model = storeys(
        measured, lambda: pm.Uniform("first", 0.5, 0.998), lambda: pm.Uniform("second", 1.003, 1.5)
    )
    draws = {"first": 0.99, "second": 1.01, "damping": 1.0, "sigma": 0.1}
    start = posterior({name: (("chain", "draw"), [[x]]) for name, x in draws.items()})
    with model, pytest.warns(CalibrationWarning) as caught:
        cal = pmf.calibrate(start, draws=200, chains=2, random_seed=1, progressbar=False)
    words = " ".join(str(w.message) for w in caught)
    assert "the data want first above 0.998, the edge of its prior, by" in words
    assert "the data want second below 1.003, the edge of its prior, by" in words
    x = cal["posterior"].to_dataset()
    assert float(x["first"].quantile(0.05)) > 0.99 and float(x["second"].quantile(0.95)) < 1.01
    predictions = Predictions(model)
    points = to_unconstrained(model, x.isel(draw=slice(None, None, 20))).reshape(-1, 4)
    fit = climb_likelihood(predictions, points[-1])
    assert fit.height > log_likelihood(predictions(predictions.space.join(model.initial_point())))
    median, best = np.median([rms(predictions, z) for z in points]), rms(predictions, fit.z)
    assert best < median < 1.5 * best


def rms(predictions, z):
    """Of the residuals at a point [m/s^2]."""
    [value] = predictions(z)
    return np.sqrt(np.mean((value.mu - value.observed) ** 2))


def test_a_positive_parameter_that_wants_to_vanish():
    """Damping of a structure without: its maximum is at zero, on its own scale, and the climb gets there."""
    from benchmarks import truth

    undamped = truth.chain_matrices(np.ones(3), np.full(3, 1200.0), (0.0, 0.0))
    response = truth.response(undamped, exact()[0])["absolute_acceleration"]
    measured = measurements("white", response, 0.02, 1.0, 3)
    model = storeys(measured, *[lambda n=n: pm.Normal(n, 1.0, 0.2) for n in ("first", "second")])
    predictions = Predictions(model)
    level = np.log(LEVEL * np.sqrt(np.mean(response**2)))
    for damping in (0.03, 0.3):
        fit = climb_likelihood(predictions, np.array([np.log(damping), 1.0, 1.0, level]))
        peak = Peak(fit, sandwich(fit.events))
        peak = peak.measured_from_bounds(peak.near_bounds())
        coordinates = peak.fit.coordinates
        assert coordinates.near.tolist() == [True, False, False, False]
        assert np.exp(peak.fit.z[0]) < 3.0 * peak.deviations[0] * np.exp(coordinates.origin[0]) < 0.05
        np.testing.assert_allclose(peak.fit.w[1:3], 1.0, atol=5.0 * peak.deviations[1])


def test_sides_of_priors():
    with pm.Model() as model:
        high = pm.HalfNormal("high")
        pm.Uniform("two", [0.0, 1.0], [2.0, 3.0])
        pm.TruncatedNormal("lower", 0.0, 1.0, lower=0.0)
        pm.Beta("unit", 1.0, 2.0)
        pm.Normal("none")
        pm.Dirichlet("shares", np.ones(3))
        pm.Uniform("depends", 0.0, high)
    assert sides_of(model, Unconstrained(model)).tolist() == [1, 2, 2, 1, 2, 0, 0, 0, 2]


def test_normal_distributions_that_are_cut():
    """Shares and quantiles as SciPy has them, on both sides and far out, and back."""
    low, high = np.array([-1.0, 3.0, -np.inf, -9.0, 30.0]), np.array([2.0, np.inf, 0.3, -8.0, 31.0])
    cut, u = truncnorm(low, high), np.random.default_rng(1).normal(size=(500, 5))
    x = quantiles(low, high, u)
    np.testing.assert_allclose(x, cut.ppf(norm.cdf(u)), rtol=1e-10)
    log_density = norm.logpdf(x) - log_share(low, high)
    np.testing.assert_allclose(log_density, cut.logpdf(x), rtol=1e-9, atol=1e-9)
    back = ndtri_exp(log_share(low, x) - log_share(low, high))
    np.testing.assert_allclose(back[:, :4], u[:, :4], atol=1e-9)


def test_coordinates():
    """There and back, and slopes by differences."""
    sides = np.array([0, 1, 2, 1, 2])
    z = np.array([0.3, -2.0, 1.5, 0.7, -4.0])
    some = Coordinates(sides, (sides > 0) & [True, True, True, False, True], z + 0.1)
    assert some.near.tolist() == [False, True, True, False, True]
    np.testing.assert_allclose(some.unconstrained(some.of(z)), z)
    assert np.isfinite(some.distance(z + 2000.0)).all()
    slopes = [(some.of(z + h) - some.of(z - h)) / 2e-6 for h in 1e-6 * np.eye(5)]
    np.testing.assert_allclose(np.diag(slopes), some.slopes(z), rtol=1e-6)


@pytest.mark.parametrize(("bound", "sign"), [(1.0, 1.0), (0.0, -1.0)])
def test_the_shortest_interval_ends_at_the_bound(bound, sign):
    """Of an exponential distribution; away from a bound it is equal-tailed."""
    x = bound - sign * np.random.default_rng(1).exponential(0.1, size=4000)
    low, high = interval(x, bound=bound)
    ends = (bound, bound - sign * 0.2303)
    np.testing.assert_allclose(sorted(ends), [low, high], atol=0.01)
    assert bound in (low, high)
    equal = interval(x)
    assert bound not in equal
    np.testing.assert_allclose(equal, np.quantile(x, [0.05, 0.95]))


@pytest.mark.slow
def test_draws_that_do_not_explain_the_data_are_refused():
    """A sigma whose prior is far below what any structure of the prior leaves over."""
    measured = measurements("white", exact()[1], 0.02, 1.0, 1)
    moved, _ = exact()
    with pm.Model() as model:
        first = pm.Uniform("first", 0.5, 0.9)
        chain = pmf.SpringMassChain(np.ones(3), 1200.0 * first * np.ones(3), pmf.RayleighDamping(0.3, 5e-4))
        mu = pmf.response(chain, pmf.Record(moved.values()[0], 0.02))
        pm.Normal("y", mu, pm.Uniform("sigma", 1e-3, 0.1), observed=measured)
    start = posterior({"first": (("chain", "draw"), [[0.89]]), "sigma": (("chain", "draw"), [[0.05]])})
    with (
        pytest.warns(CalibrationWarning),
        pytest.raises(
            ValueError, match="calibrated draws must explain the data, .* times as large as their own"
        ),
    ):
        pmf.calibrate(start, model=model, draws=100, chains=2, random_seed=1, progressbar=False)
