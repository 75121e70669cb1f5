"""`event_check`: whether several events agree, and the interval of what they have in common."""

import numpy as np
import pytest
import xarray as xr
from scipy.stats import kstest, norm, t

from pymc_features import event_check
from pymc_features.calibration.events import between, interval, joint_q


def posterior(theta, draws=400, seed=0, **others):
    """Draws of theta (2,), normal with the moments that are given, exactly."""
    mean, covariance = theta
    x = np.random.default_rng(seed).normal(size=(draws, len(mean)))
    x = (x - x.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(x, rowvar=False))).T
    x = mean + x @ np.linalg.cholesky(covariance).T
    values = {"theta": (("chain", "draw", "floor"), x[None])} | others
    return xr.DataTree.from_dict({"posterior": xr.Dataset(values, coords={"floor": ["a", "b"]})})


COVARIANCE = np.array([[0.04, 0.03], [0.03, 0.09]])
EVENTS = [
    posterior((mean, COVARIANCE), seed=i) for i, mean in enumerate([[1.0, 2.0], [1.2, 2.1], [2.6, 2.4]])
]


def test_by_hand():
    """Equal variances: Q is the sum of squares over the variance, the interval that of Student."""
    found = event_check(EVENTS)
    assert list(found["parameter"].values) == ["theta[a]", "theta[b]"]
    x = np.array([1.0, 1.2, 2.6])
    q = np.sum((x - x.mean()) ** 2) / 0.04
    first = found.sel(parameter="theta[a]")
    np.testing.assert_allclose(first["q"], q, rtol=1e-8)
    np.testing.assert_allclose(first["growth"], np.sqrt(q / 2), rtol=1e-8)
    np.testing.assert_allclose(first["scatter"] ** 2, x.var(ddof=1) - 0.04, rtol=1e-6)
    lower, upper = t.interval(0.9, 2, x.mean(), x.std(ddof=1) / np.sqrt(3))
    np.testing.assert_allclose([first["lower"], first["upper"]], [lower, upper], rtol=1e-8)
    assert not found.attrs["compatible"] and "that of theta[a] 4.3" in found.attrs["message"]
    agree = event_check([EVENTS[0], EVENTS[0]])
    assert agree.attrs["compatible"] and "agree" in agree.attrs["message"] and agree.attrs["growth"] == 1.0


def test_joint_q_is_chi_square():
    """Of means with the covariances stated; of means 1.4 times as far apart it is not (control)."""
    rng = np.random.default_rng(11)
    factor = np.linalg.cholesky(COVARIANCE)
    covariances = np.stack([COVARIANCE, 4.0 * COVARIANCE, 0.5 * COVARIANCE])
    scale = np.array([1.0, 2.0, np.sqrt(0.5)])[:, None]
    for spread, fits in ((1.0, True), (1.4, False)):
        q = [joint_q(spread * scale * (rng.normal(size=(3, 2)) @ factor.T), covariances) for _ in range(400)]
        assert (kstest(q, "chi2", args=(4,)).pvalue > 1e-3) == fits


@pytest.mark.slow
@pytest.mark.parametrize("scatter", [0.0, 1.0])
def test_interval_of_three_events_contains_the_truth(scatter):
    """As often as it says, with variances that differ; what assumes no scatter does not (control).

    The false-alarm rate of the bounds, four standard errors, is 1e-4.
    """
    rng, n, hits, naive = np.random.default_rng(5), 2000, 0, 0
    for _ in range(n):
        v = rng.uniform(0.5, 2.0, size=3)
        x = rng.normal(size=3) * np.sqrt(v + scatter**2)
        one = between(x, v, 0.9)
        hits += one["lower"] < 0.0 < one["upper"]
        naive += abs(np.sum(x / v)) < norm.ppf(0.95) * np.sqrt(np.sum(1 / v))
    assert abs(hits / n - 0.9) < 4.0 * np.sqrt(0.09 / n) + 0.015
    assert (naive / n < 0.75) == (scatter > 0)


def test_noise_is_left_out_where_it_is_known_to_be_noise():
    sigma = {"sigma": (("chain", "draw"), np.linspace(1, 2, 400)[None])}
    events = [posterior((mean, COVARIANCE), **sigma) for mean in ([1.0, 2.0], [1.1, 2.0])]
    assert "sigma" in event_check(events)["parameter"].values
    for event in events:
        names = {"parameter": ["theta[0]", "theta[1]", "sigma"]}
        known = xr.Dataset({"changes_response": ("parameter", [True, True, False])}, coords=names)
        event["calibration"] = xr.DataTree(known)
    assert list(event_check(events)["parameter"].values) == ["theta[a]", "theta[b]"]
    assert list(event_check(events, var_names=["sigma"])["parameter"].values) == ["sigma"]


OTHER = xr.DataTree.from_dict({"posterior": EVENTS[0]["posterior"].to_dataset().isel(floor=[0])})


@pytest.mark.parametrize(
    ("events", "settings", "error", "words"),
    [
        (EVENTS[:1], {}, TypeError, "two or more posteriors, got 1"),
        (EVENTS[0], {}, TypeError, "got DataTree"),
        ([EVENTS[0], xr.DataTree()], {}, TypeError, "group `posterior`, got .* That is event 1. Pass what"),
        (EVENTS, {"var_names": ["k"]}, ValueError, "got no k in event 0"),
        (EVENTS, {"probability": 90}, ValueError, "between 0 and 1"),
        ([posterior(([0.0, 0.0], COVARIANCE), draws=10)] * 2, {}, ValueError, "at least 20 draws"),
        ([EVENTS[0], OTHER], {}, ValueError, "with one shape"),
    ],
)
def test_bad_input(events, settings, error, words):
    with pytest.raises(error, match=words):
        event_check(events, **settings)


@pytest.mark.parametrize(("bound", "sign"), [(1.0, 1.0), (0.0, -1.0)])
def test_the_shortest_interval_ends_at_the_bound(bound, sign):
    """Of an exponential distribution; away from a bound it is equal-tailed."""
    x = bound - sign * np.random.default_rng(1).exponential(0.1, size=4000)
    found = interval(x, bound=bound)
    np.testing.assert_allclose(sorted((bound, bound - sign * 0.2303)), found, atol=0.01)
    assert bound in found
    np.testing.assert_allclose(interval(x), np.quantile(x, [0.05, 0.95]))
