"""`compare`: against the evidences of conjugate models, and what it refuses to compare."""

import numpy as np
import pymc as pm
import pytest
import xarray as xr
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal

from pymc_features import compare, sample, sample_smc
from pymc_features.events.compare import ljung_box, stacking_weights

QUIET = {"cores": 1, "chains": 2, "random_seed": 1, "progressbar": False}
TIME, NOISE = np.linspace(0.0, 6.0, 60), 0.3
RNG = np.random.default_rng(8)
DATA = np.sin(TIME) + NOISE * RNG.normal(size=60)


def stored(log_evidence, error=0.01, data=(1.0, 2.0), kind="data", **groups):
    """A result as it is stored, without sampling."""
    stats = {"log_evidence": log_evidence, "log_evidence_se": error, "likelihoods": f'{{"y": "{kind}"}}'}
    parts = {
        "posterior": xr.Dataset({"x": (("chain", "draw"), RNG.normal(size=(2, 100)))}),
        "sample_stats": xr.Dataset(attrs=stats),
        "observed_data": xr.Dataset({"y": ("time", np.asarray(data))}),
    }
    return xr.DataTree.from_dict(parts | groups)


def line(shape, width, data=DATA):
    with pm.Model() as model:
        scale = pm.Normal("scale", 0.0, width)
        pm.Normal("y", scale * shape, NOISE, observed=data[None])
    return model


def test_conjugate_models():
    """Probabilities within 0.02 of the exact ones; what the wrong shape leaves is not white."""
    cases = {"narrow": (np.sin(TIME), 1.0), "wide": (np.sin(TIME), 4.0), "wrong": (TIME / 6.0, 1.0)}
    models = {name: line(*case) for name, case in cases.items()}
    posteriors = {name: sample(500, model=model, check=None, **QUIET) for name, model in models.items()}
    found = compare(posteriors, checks=models, prior={"narrow": 1.0, "wide": 2.0, "wrong": 1.0})["comparison"]
    covariances = [NOISE**2 * np.eye(60) + w**2 * np.outer(f, f) for f, w in cases.values()]
    log_z = np.array([multivariate_normal.logpdf(DATA, cov=c) for c in covariances])
    exact = np.array([1.0, 2.0, 1.0]) * np.exp(log_z - log_z.max())
    np.testing.assert_allclose(found["log_evidence"], log_z, atol=4.0 * found["log_evidence_se"].max())
    np.testing.assert_allclose(found["probability"], exact / exact.sum(), atol=0.02)
    assert 0.2 < found["probability"][1] < 0.5 and found["probability"][2] < 1e-6
    assert found.attrs["best"] == "narrow" and not found.attrs["decided"] and found.attrs["explained"]
    assert found["p_white"][0] > 0.01 and found["p_white"][2] < 1e-6
    wrong = {name: posteriors["wrong"] for name in ("a", "b")}
    found = compare(wrong, checks=dict.fromkeys(wrong, models["wrong"]))["comparison"]
    assert not found.attrs["explained"] and "None of the models explains the data" in found.attrs["message"]


def test_kernels_of_sample_smc_say_what_they_sampled():
    idata = sample_smc(100, model=line(np.sin(TIME), 1.0), **QUIET)
    assert idata["sample_stats"].attrs["likelihoods"] == '{"y": "data"}'


def test_decisions():
    """Far apart they are one, equal ones are none, and uncertain ones are refused."""
    decided = compare({"b": stored(-20.0), "a": stored(-10.0)})["comparison"].attrs
    assert decided["decided"] and decided["best"] == "a" and "decide for it" in decided["message"]
    equal = compare({"a": stored(-10.0), "b": stored(-10.0)})["comparison"].attrs
    assert not equal["decided"] and "do not decide" in equal["message"]
    compare({"a": stored(-10.0, 2.0), "b": stored(-40.0, 2.0)})  # certain all the same
    with pytest.raises(ValueError, match="known well enough to compare them, got -10.0 \\+- 2, -11.0 \\+- 2"):
        compare({"a": stored(-10.0, 2.0), "b": stored(-11.0, 2.0)})


def test_events_with_their_own_parameters():
    def event(shift):
        x = shift + np.random.default_rng(1).normal(size=(2, 100))
        return stored(-5.0, posterior=xr.Dataset({"x": (("chain", "draw"), x)}))

    models = {"steady": [event(0.0), event(0.5)], "jumping": [event(0.0), event(9.0)]}
    found = compare(models)["comparison"]
    np.testing.assert_allclose(found["log_evidence"], -10.0)
    assert found["p_events"][0] > 0.05 > found["p_events"][1] and found.attrs["explained"]
    found = compare({name: models["jumping"] for name in "ab"})["comparison"]
    assert not found.attrs["explained"]


def test_average_and_stacking():
    """Each model's share of the draws is its probability; stacking weights are those of a scalar search."""
    predictions = {
        name: xr.Dataset({"drift": (("chain", "draw"), np.full((2, 500), value))})
        for name, value in (("a", 1.0), ("b", 3.0))
    }
    scores = RNG.normal(size=(2, 7))
    held_out = dict(zip("ab", scores, strict=True))
    models = {"a": stored(-10.0), "b": stored(-10.0 + np.log(3.0))}
    found = compare(models, predictions=predictions, held_out=held_out, random_seed=1)
    assert found["prediction"].sizes["sample"] == 1000
    assert abs(float(found["prediction"]["drift"].mean()) - 2.5) < 0.01
    best = minimize_scalar(
        lambda w: -np.logaddexp(np.log(w) + scores[0], np.log1p(-w) + scores[1]).sum(),
        bounds=(1e-9, 1 - 1e-9),
        method="bounded",
        options={"xatol": 1e-10},
    )
    np.testing.assert_allclose(found["comparison"]["stacking"], [best.x, 1.0 - best.x], atol=1e-4)
    np.testing.assert_allclose(stacking_weights(np.array([[0.0, 0.0], [-9.0, -9.0]])), [1.0, 0.0], atol=1e-6)


def test_whiteness_has_its_size():
    """White noise is refused as often as it should be; an autoregression of 0.3 nearly always (control)."""
    white = np.random.default_rng(2).normal(size=(400, 301))
    coloured = white[:, 1:] + 0.3 * white[:, :-1]
    assert abs(np.mean([ljung_box(x) < 0.1 for x in white]) - 0.1) < 4.0 * np.sqrt(0.09 / 400)
    assert np.mean([ljung_box(x) < 0.1 for x in coloured]) > 0.9


def test_refusals():
    one = stored(-10.0)
    with pytest.raises(TypeError, match="`models` must be a dict of two or more posteriors"):
        compare({"a": one})
    with pytest.raises(ValueError, match="`models` must be of the same data, got others for b than for a"):
        compare({"a": one, "b": stored(-10.0, data=(1.0, 3.0))})
    with pytest.raises(ValueError, match="densities of the same, got data for a and feature of ExpFeature"):
        compare({"a": one, "b": stored(-10.0, kind="feature of ExpFeature")})
    calibrated = stored(-10.0, calibration=xr.Dataset({"x": 1.0}))
    with pytest.raises(ValueError, match="none for b: `calibrate` stretches the likelihood"):
        compare({"a": one, "b": calibrated})
    silent = stored(-10.0)
    del silent["sample_stats"].attrs["likelihoods"]
    with pytest.raises(ValueError, match="say what their likelihoods are, got none for b"):
        compare({"a": one, "b": silent})
    both = {"a": one, "b": one}
    with pytest.raises(ValueError, match="`prior` must be of the models a, b, got a"):
        compare(both, prior={"a": 1.0})
    with pytest.raises(ValueError, match="`prior` must be a positive number for each model"):
        compare(both, prior={"a": 1.0, "b": 0.0})
    with pytest.raises(ValueError, match="`held_out` must be a number of each event for each model"):
        compare(both, held_out={"a": [1.0], "b": [1.0, 2.0]})
    with pytest.raises(TypeError, match="`checks` must be a dict of pymc.Model"):
        compare(both, checks={"a": 1.0, "b": 1.0})
    with pytest.raises(TypeError, match="`predictions` must be a dict of Datasets"):
        compare(both, predictions={"a": 1.0, "b": 1.0})
