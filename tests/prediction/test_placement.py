"""`sensor_placement`: against exhaustive search, and a linear model worked by hand."""

from itertools import combinations

import numpy as np
import pymc as pm
import pytest
import xarray as xr

import pymc_features as pmf
from pymc_features.prediction.sensors import Information, best_sensors, gram_matrices
from support.refusals import refusals

CRITERIA = ("D", "A", "prediction")
N, TIMES = 10, 40


def linear(design, sigma=0.5, coords=None):
    """Response design (sensor, time, parameter) times theta, which has the prior Normal(0, 2)."""
    with pm.Model(coords=coords) as model:
        theta = pm.Normal("theta", 0.0, 2.0, shape=design.shape[-1])
        dims = ("place", "time") if coords else None
        pm.Normal("y", (design * theta).sum(axis=-1), sigma, observed=np.zeros(design.shape[:2]), dims=dims)
    return model


def modal_design(rng):
    """Sensitivities along a cantilever: mode shapes times oscillations, with random weights."""
    x, t = np.linspace(0.1, 1.0, N), np.linspace(0.0, 3.0, TIMES)
    shapes = [np.sin((k - 0.5) * np.pi * x + 0.2 * rng.normal()) for k in (1, 2, 3)]
    modes = [np.outer(s, np.sin((3 + 4 * k) * t + rng.uniform(0, 6))) for k, s in enumerate(shapes)]
    return np.stack([np.tensordot(rng.normal(size=3), modes, axes=1) for _ in range(4)], axis=-1)


def correlation(length, n=N):
    x = np.arange(n)
    return np.exp(-np.abs(x[:, None] - x) / length)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_as_good_as_trying_all(criterion):
    """Three of ten places, ten structures at three points each: equal in nine at least, never below 0.95."""
    equal = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        s = np.stack([modal_design(rng) for _ in range(3)])
        gram = 0.3 * np.einsum("kitp,kjtq->kijpq", s, s)
        information = Information(gram, correlation(2.0), criterion)
        best = max(information.gain(list(c)) for c in combinations(range(N), 3))
        chosen, gains = best_sensors(information, 3)
        assert gains[-1] == information.gain(chosen) >= 0.95 * best
        equal.append(gains[-1] > (1.0 - 1e-9) * best)
    assert sum(equal) >= 9


def test_by_hand():
    """A linear model: the gain is that of the Gaussian posterior with the full covariance of the errors."""
    rng = np.random.default_rng(1)
    design = rng.normal(size=(4, 6, 2))
    names = ["base", "first", "second", "roof"]
    model = linear(design, coords={"place": names, "time": np.arange(6)})
    found = pmf.sensor_placement(model, names, 2, draws=2, correlation_length=1.5, random_seed=1)
    values = {}
    for pair in combinations(range(4), 2):
        covariance = 0.25 * np.kron(correlation(1.5, 4)[np.ix_(pair, pair)], np.eye(6))
        jacobian = design[list(pair)].reshape(12, 2)
        precision = np.eye(2) + 4.0 * jacobian.T @ np.linalg.solve(covariance, jacobian)
        values[pair] = 0.5 * np.linalg.slogdet(precision)[1]
    best = max(values, key=values.get)
    assert set(found["sensor"].values) == {names[i] for i in best}
    # the scale of the prior is that of 500 draws
    np.testing.assert_allclose(found["gain"][-1], values[best], atol=0.15)
    assert found["chosen"].values.sum() == 2 and (found["gain"].diff("order") > 0).all()
    few = pmf.sensor_placement(model, ["base", "roof"], 1, criterion="A", draws=2, random_seed=1)
    assert few["sensor"].values[0] in ("base", "roof") and 0.0 < few["gain"][0] < 1.0


def test_two_sensors_do_not_end_side_by_side():
    """One mode: with errors that neighbours share the second stays away; without (control) it does not."""
    x = np.linspace(0.1, 1.0, N)
    design = np.outer(np.sin(0.5 * np.pi * x), np.sin(np.arange(TIMES)))[..., None]
    gram = np.einsum("itp,jtq->ijpq", design, design)[None]
    apart = {}
    for length in (5.0, 1e-6):
        chosen, _ = best_sensors(Information(gram, correlation(length), "D"), 2)
        apart[length] = abs(chosen[0] - chosen[1])
    assert apart[1e-6] == 1 and apart[5.0] >= 3


def test_of_a_structure():
    """Sensitivities of a chain are those by central differences; with a posterior; the figure."""
    record = pmf.synthetic_earthquake(3.0, 0.02, random_seed=1)

    def structure(k):
        return pmf.SpringMassChain(np.ones(4), 900.0, pmf.ModalDamping(0.03)).scale_stiffness(
            k, springs=[0, 1]
        )

    with pm.Model() as model:
        k = pm.Normal("k", 1.0, 0.1)
        y = pmf.response(structure(k), record)
        pm.Normal("y", y, 0.2, observed=np.zeros((4, record.n_times)))
    [gram] = gram_matrices(model, np.array([[1.0]]), [0, 1, 2, 3])
    ends = [pmf.simulate(structure(1.0 + h), record).values for h in (1e-4, -1e-4)]
    slope = (ends[0] - ends[1]) / 2e-4 / 0.2
    scale = np.sqrt(gram[0, 0, 0, 0] / (slope[0] @ slope[0]))
    assert abs(scale / 0.1 - 1.0) < 0.1  # of 500 draws from the prior
    np.testing.assert_allclose(gram[..., 0, 0], scale**2 * slope @ slope.T, rtol=1e-3)
    draws = xr.Dataset({"k": (("chain", "draw"), np.full((1, 30), 1.0))})
    idata = xr.DataTree.from_dict({"posterior": draws})
    found = pmf.sensor_placement(model, None, 2, "prediction", idata=idata, draws=1, random_seed=1)
    axes = pmf.plots.sensor_placement(found)
    assert len(axes) == 2 and [t.get_text() for t in axes[0].texts] == ["1", "2"]
    pmf.plots.close(axes)
    with pytest.raises(TypeError, match="`result` must be a Dataset"):
        pmf.plots.sensor_placement(None)


REFUSED = {  # what is said: what is given
    "`n` must be an integer from 1 to 3, got 4": {"n": 4},
    "`candidates` must be different ones of": {"candidates": [0, 9]},
    "`criterion` must be one of D, A, prediction, got 'E'": {"criterion": "E"},
    "`positions` must be all different": {"positions": [0.0, 1.0, 1.0]},
    r"`positions` must be of shape \(3,\) or \(3, axis\), got \(2, 1\)": {"positions": [0.0, 1.0]},
}


@refusals(
    "given", REFUSED, {"keyword arguments of sensor_placement.* draws, random_seed, got 'seed'": {"seed": 1}}
)
def test_bad_input(given, error, match):
    with pytest.raises(error, match=match):
        pmf.sensor_placement(linear(np.ones((3, 4, 1))), **({"candidates": None, "n": 1} | given))
