"""`hierarchical`: against quadrature and closed forms, from exact draws of the events."""

from functools import partial
from importlib import import_module

import numpy as np
import pymc as pm
import pytest
import xarray as xr
from scipy.stats import halfnorm, multivariate_normal, norm

from pymc_features import compare, hierarchical, sample
from pymc_features.exceptions import SamplingWarning
from pymc_features.smc.density import rows

QUIET = {"cores": 1, "chains": 2, "random_seed": 1, "progressbar": False}
PROBABILITIES = [0.05, 0.5, 0.95]
EFFECTS = np.array([28.0, 8.0, -3.0, 7.0, -1.0, 1.0, 18.0, 12.0])  # eight schools, Rubin (1981)
ERRORS = np.array([15.0, 10.0, 16.0, 11.0, 9.0, 11.0, 10.0, 18.0])


@pytest.fixture(autouse=True)
def unchecked(monkeypatch):
    """The look for what a run missed is most of its time, and has tests of its own."""
    module = import_module("pymc_features.events.hierarchical")
    monkeypatch.setattr(module, "sample", partial(sample, check=None))


def event(y, error, width, n, rng):
    """Exact draws (n,) given y ~ Normal(theta, error) under theta ~ Normal(0, width), and the model."""
    y = np.asarray(y, dtype=float)
    with pm.Model() as model:
        theta = pm.Normal("theta", 0.0, width, shape=y.shape)
        pm.Normal("y", theta, error, observed=y)
    variance = 1.0 / (width**-2 + error**-2)
    draws = variance * y / error**2 + np.sqrt(variance) * rng.normal(size=(2, n // 2, *y.shape))
    dims = ("chain", "draw", *[f"x{i}" for i in range(y.ndim)])
    evidence = norm.logpdf(y, 0.0, np.hypot(width, error)).sum()
    stats = {"log_evidence": evidence, "log_evidence_se": 0.0, "likelihoods": '{"y": "data"}'}
    tree = {
        "posterior": xr.Dataset({"theta": (dims, draws)}),
        "sample_stats": xr.Dataset(attrs=stats),
        "observed_data": xr.Dataset({"y": ([f"x{i}" for i in range(y.ndim)], y)}),
        "log_prior": xr.Dataset({"theta": (dims, norm.logpdf(draws, 0.0, width))}),
    }
    return xr.DataTree.from_dict(tree), model


def population(scatter=None, shape=()):
    with pm.Model() as hyper:
        mean = pm.Normal("mean", 0.0, 10.0)
        scatter = pm.HalfNormal("scatter", 10.0) if scatter is None else scatter
        theta = pm.Normal("theta", mean, scatter, shape=shape)
        pm.Deterministic("twice", 2.0 * theta)  # of one event: no parameter of the population
    return hyper


@pytest.mark.default_mode
@pytest.mark.slow
def test_eight_schools(monkeypatch):
    """Mean, scatter, evidence and the next school, by quadrature; without a compilation of ten seconds.

    Bounds are four standard errors: 1 to 3 % of the 5-95 % width for quantiles of 1500 draws; 2400
    stored draws of each school add less.
    """
    rng = np.random.default_rng(3)
    events = [event(y, s, 20.0, 2400, rng)[0] for y, s in zip(EFFECTS, ERRORS, strict=True)]
    has_loops, looked = rows.has_python_loops, []
    monkeypatch.setattr(rows, "has_python_loops", lambda v: looked.append(has_loops(v)) or looked[-1])
    found = hierarchical(events, population(), event_draws=2400, draws=750, **QUIET)
    assert looked and not any(looked)  # else Numba compiles the sum over the draws of the events
    mean, scatter = np.meshgrid(np.linspace(-40, 50, 601), np.linspace(1e-3, 60, 800), indexing="ij")
    log_p = norm.logpdf(mean, 0.0, 10.0) + halfnorm.logpdf(scatter, 0.0, 10.0)
    for y, s in zip(EFFECTS, ERRORS, strict=True):
        log_p += norm.logpdf(y, mean, np.hypot(scatter, s))
    p = np.exp(log_p - log_p.max())
    cell = (mean[1, 0] - mean[0, 0]) * (scatter[0, 1] - scatter[0, 0])
    log_evidence = log_p.max() + np.log(p.sum() * cell)
    for name, grid in (("mean", mean), ("scatter", scatter)):
        exact = np.quantile(grid, PROBABILITIES, weights=p, method="inverted_cdf")
        sampled = np.quantile(found["posterior"][name], PROBABILITIES)
        assert np.abs(sampled - exact).max() < 0.1 * (exact[-1] - exact[0]), name
    stats = found["sample_stats"].attrs
    assert 0.005 < stats["log_evidence_se"] < 0.1
    assert abs(stats["log_evidence"] - log_evidence) < 4.0 * stats["log_evidence_se"]
    following = found["predictive"]["theta"].values
    below = (p * norm.cdf(10.0, mean, scatter)).sum() / p.sum()
    assert abs((following < 10.0).mean() - below) < 4.0 * np.sqrt(0.25 / 1500) + 0.02
    first = found["events"]["theta"].values[..., 0]
    shrunk = (mean * ERRORS[0] ** 2 + EFFECTS[0] * scatter**2) / (ERRORS[0] ** 2 + scatter**2)
    shrunk = (p * shrunk).sum() / p.sum()
    assert abs(first.mean() - shrunk) < 4.0 * first.std() / np.sqrt(750)
    assert found["events"]["pareto_k"].values.max() < 0.7
    assert "twice" not in found["posterior"]
    with pm.Model() as pooled:  # one value for all schools
        mean = pm.Normal("mean", 0.0, 10.0)
        for i, (y, s) in enumerate(zip(EFFECTS, ERRORS, strict=True)):
            pm.Normal(f"y{i}", mean, s, observed=y)
    one = sample(500, model=pooled, check=None, **QUIET)
    told = compare({"population": found, "one value": one})["comparison"]
    exact = multivariate_normal(np.zeros(8), np.diag(ERRORS**2) + 100.0).logpdf(EFFECTS)
    exact = 1.0 / (1.0 + np.exp(exact - log_evidence))
    np.testing.assert_allclose(told["probability"][0], exact, atol=0.03)
    assert not told.attrs["decided"]


@pytest.mark.slow
def test_an_event_that_hardly_overlaps_is_sampled_again():
    """One with a vague posterior, among others that are precise: closed form. Left as it is, it misleads."""
    rng, scatter = np.random.default_rng(4), 1.0
    data, errors, widths = np.array([3.0, 5.0, -90.0]), np.array([2.0, 3.0, 150.0]), [20.0, 20.0, 300.0]
    cases = [event(*case, 400, rng) for case in zip(data, errors, widths, strict=True)]
    events, models = zip(*cases, strict=True)
    settings = {**QUIET, "draws": 300, "event_draws": 600}
    match = "events 2 .* hardly overlap with the population.*Pass their `mod"
    with pytest.warns(SamplingWarning, match=match):
        poor = hierarchical(events, population(scatter), **settings)
    found = hierarchical(events, population(scatter), models=models, **settings)
    assert poor["events"]["pareto_k"].values[2] > 0.7 and not poor["events"]["sampled_again"].values.any()
    assert found["events"]["pareto_k"].values.max() < 0.7
    assert list(found["events"]["sampled_again"].values) == [0, 0, 1]
    spread = errors**2 + scatter**2
    variance = 1.0 / (0.01 + (1.0 / spread).sum())
    draws, stats = found["posterior"]["mean"].values, found["sample_stats"].attrs
    assert abs(draws.mean() - variance * (data / spread).sum()) < 5.0 * np.sqrt(variance / 600)
    assert abs(draws.std() / np.sqrt(variance) - 1.0) < 5.0 / np.sqrt(2 * 600)
    evidence = multivariate_normal(np.zeros(3), np.diag(spread) + 100.0).logpdf(data)
    assert abs(stats["log_evidence"] - evidence) < 4.0 * stats["log_evidence_se"] < 0.5


def test_bad_input():
    rng = np.random.default_rng(5)
    (one, model), (other, _) = event(1.0, 1.0, 5.0, 200, rng), event([1.0, 2.0], 1.0, 5.0, 200, rng)
    hyper = population()
    with pytest.raises(TypeError, match="two or more posteriors, got 1"):
        hierarchical([one], hyper)
    with pytest.raises(TypeError, match="`hyper` must be a pymc.Model"):
        hierarchical([one, one], "theta")
    with pytest.raises(ValueError, match="of shape \\(\\), as in `hyper`, got \\(2,\\) in event 1"):
        hierarchical([one, other], hyper)
    with pytest.raises(ValueError, match="`models` must be as many as `events`, 2, got 1"):
        hierarchical([one, one], hyper, models=[model])
    with pm.Model() as stranger:
        pm.Normal("stiffness", pm.Normal("mean"))
    with pytest.raises(
        ValueError, match="free variables that the events have.*got mean, stiffness, of which"
    ):
        hierarchical([one, one], stranger)
    bare = xr.DataTree.from_dict({"posterior": one["posterior"].to_dataset()})
    with pytest.raises(ValueError, match="must have a group `log_prior` of theta.*none in event 1"):
        hierarchical([one, bare], hyper)
