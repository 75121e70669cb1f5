"""Updating in sequence: against the Kalman filter, whose closed form it must meet for linear models."""

import numpy as np
import pymc as pm
import pytest
from scipy.stats import multivariate_normal

from pymc_features import sample
from pymc_features.events import continue_with, sample_in_sequence
from pymc_features.events import sequence as run
from pymc_features.events.sequence import fit_density
from pymc_features.exceptions import StudyMismatchError

QUIET = {"cores": 1, "progressbar": False}
RNG = np.random.default_rng(5)
DESIGN, THETA, NOISE, PRIOR = RNG.normal(size=(5, 8, 2)), np.array([1.0, -0.5]), 0.5, 3.0
DATA = DESIGN @ THETA + NOISE * RNG.normal(size=(5, 8))
Z90 = 1.6449


def linear():
    with pm.Model() as model:
        design, data = pm.Data("design", DESIGN[0]), pm.Data("data", DATA[0])
        theta = pm.Normal("theta", 0.0, PRIOR, shape=2)
        pm.Normal("y", design @ theta, NOISE, observed=data)
    return model


def event(i, data=DATA):
    return {"design": DESIGN[i], "data": data[i]}


def filtered(mean, covariance, i, data=DATA):
    """Mean, covariance and log score after one more event, by Kalman's equations."""
    a, y = DESIGN[i], data[i]
    s = a @ covariance @ a.T + NOISE**2 * np.eye(len(y))
    gain = covariance @ a.T @ np.linalg.inv(s)
    score = multivariate_normal.logpdf(y, a @ mean, s)
    return mean + gain @ (y - a @ mean), covariance - gain @ a @ covariance, score


def off(idata, mean, covariance):
    """Largest error of 5, 50 and 95 % quantiles over the width."""
    exact = mean + np.sqrt(np.diag(covariance)) * Z90 * np.array([[-1.0], [0.0], [1.0]])
    found = idata["posterior"]["theta"].quantile([0.05, 0.5, 0.95], dim=("chain", "draw")).values
    return np.abs((found - exact) / (exact[2] - exact[0])).max()


@pytest.mark.slow
def test_three_events_are_those_of_the_kalman_filter():
    """With a random walk, and with forgetting; then a change, after which the events before are forgotten.

    Quantiles of 4000 draws after three fits to as many have a standard error of 2 % of the width.
    """
    model, state = linear(), (np.zeros(2), PRIOR**2 * np.eye(2))
    pm.set_data(event(0), model=model)
    idata = sample(2000, model=model, chains=2, random_seed=1, check=None, **QUIET)
    *state, _ = filtered(*state, 0)
    steps = [({}, lambda v: v), ({"drift": {"theta": 0.3}}, lambda v: v + 0.09 * np.eye(2))]
    steps.append(({"forgetting": 0.5}, lambda v: 2.0 * v))
    for i, (settings, predicted) in enumerate(steps, 1):
        pm.set_data(event(i), model=model)
        idata = continue_with(idata, model=model, random_seed=i, **settings, **QUIET)
        *state, score = filtered(state[0], predicted(state[1]), i)
        assert off(idata, *state) < 0.08
        last = idata["sequence"].isel(event=-1)
        assert abs(last["log_score"] - score) < 4.0 * last["log_score_se"] < 0.4
        assert not last["alarm"] and last["probability_changed"] < 1e-2
        _, _, fresh = filtered(np.zeros(2), PRIOR**2 * np.eye(2), i)
        assert abs(last["log_score_fresh"] - fresh) < 0.3
    assert list(idata["sequence"]["event"].values) == [0, 1, 2, 3]
    np.testing.assert_allclose(idata["sequence"]["mean"][-1], state[0], atol=0.05)
    broken = DESIGN @ (THETA + np.array([3.0, 0.0])) + NOISE * RNG.normal(size=(5, 8))
    pm.set_data(event(4, broken), model=model)
    idata = continue_with(idata, model=model, random_seed=9, **QUIET)
    assert idata["sequence"]["alarm"].values.tolist() == [0, 0, 0, 0, 1]
    *fresh, _ = filtered(np.zeros(2), PRIOR**2 * np.eye(2), 4, broken)
    assert off(idata, *fresh) < 0.08
    assert off(idata, *filtered(*state, 4, broken)[:2]) > 0.5  # the control: not forgotten


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on(tmp_path, monkeypatch):
    """Between events, to the same draws; with another event at some place it is refused."""
    model, called = linear(), []
    settings = {"model": model, "draws": 150, "random_seed": 3, **QUIET}

    def counting(*args, **kwargs):
        called.append(1)
        if len(called) == 2:
            raise KeyboardInterrupt
        return continue_with(*args, **kwargs)

    events = [event(0), event(1), event(2)]
    monkeypatch.setattr(run, "continue_with", counting)
    with pytest.raises(KeyboardInterrupt):
        sample_in_sequence(events, out=tmp_path, **settings)
    resumed = sample_in_sequence(events, out=tmp_path, **settings)
    assert len(called) == 3
    whole = sample_in_sequence(events, **settings)
    np.testing.assert_array_equal(resumed["posterior"]["theta"], whole["posterior"]["theta"])
    assert resumed["sequence"].sizes["event"] == 3
    with pytest.raises(StudyMismatchError, match="same events, got .* with another one at place 1"):
        sample_in_sequence([event(0), event(3)], out=tmp_path, **settings)
    with pytest.raises(StudyMismatchError, match="draws = 150 instead of 151"):
        sample_in_sequence(events, out=tmp_path, **settings | {"draws": 151})


@pytest.mark.parametrize("bent", [False, True])
def test_fitted_density(bent):
    """Integrates to one, and is near the law of the draws; of a banana by a map, of a Gaussian by moments."""
    rng = np.random.default_rng(6)
    x = rng.normal(size=(3000, 2))
    if bent:
        x[:, 1] = 0.5 * x[:, 1] + x[:, 0] ** 2
    density = fit_density(x, rng)
    assert hasattr(density, "map") == bent
    grid = np.stack(np.meshgrid(np.linspace(-7, 7, 500), np.linspace(-12, 30, 1500), indexing="ij"), axis=-1)
    q = np.exp(density.log_density(grid.reshape(-1, 2)))
    assert abs(q.sum() * (14 / 499) * (42 / 1499) - 1.0) < 0.02
    drawn = density.draw(20_000, rng)
    np.testing.assert_allclose(
        np.quantile(drawn, [0.05, 0.5, 0.95], axis=0), np.quantile(x, [0.05, 0.5, 0.95], axis=0), atol=0.25
    )
    wide = fit_density(x, np.random.default_rng(1), forgetting=0.25).draw(20_000, rng)
    if not bent:
        np.testing.assert_allclose(wide.std(axis=0), 2.0 * x.std(axis=0), rtol=0.04)


def test_refusals():
    model = linear()
    idata = sample_in_sequence([event(0)], model=model, draws=100, **QUIET)
    with pytest.raises(ValueError, match="`drift` must be of the parameters theta, got stiffness"):
        continue_with(idata, model=model, drift={"stiffness": 0.1})
    with pytest.raises(ValueError, match="`forgetting` must lie between 0 and 1, got 1.5"):
        continue_with(idata, model=model, forgetting=1.5)
    with pytest.raises(TypeError, match="keyword arguments of continue_with.*'chain'"):
        continue_with(idata, model=model, chain=2)
    with pytest.raises(TypeError, match="`events` must be a sequence of pymc.Model"):
        sample_in_sequence([event(0)])
    with pm.Model() as other:
        pm.Normal("stiffness")
    with pytest.raises(ValueError, match="got none of stiffness"):
        continue_with(idata, model=other)
