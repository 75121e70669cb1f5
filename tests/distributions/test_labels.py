"""Labelled data: every likelihood takes them by their labels, whatever the order they come in."""

import numpy as np
import pymc as pm
import pytest
import xarray as xr

import pymc_features as pmf
from support.structures import noise_record

RNG = np.random.default_rng(0)
MU, VALUES = np.arange(9.0).reshape(3, 3), RNG.normal(size=(3, 3))
NAMES = ["roof", "third", "base"]
CHAIN = pmf.SpringMassChain(np.ones(3), 900.0 * np.ones(3), pmf.ModalDamping(0.05))


def ambient(observed, **dims):
    spectral = pmf.ambient.spectral_response(CHAIN, 1.0)
    return pmf.AmbientResponse(
        "y", spectral, error=0.1, bands=[(1.0, 20.0)], dt=0.02, observed=observed, **dims
    )


def shapes(observed, **dims):
    found = {"frequencies": [2.0, 5.0, 7.0], "shapes": observed}
    return pmf.ModalFeature("y", pmf.modes(CHAIN), observed=found, sigma_f=0.1, sigma_phi=0.1)


LIKELIHOODS = {
    "TN": lambda y, **dims: pmf.TruncNormalFeature("y", mu=MU, sigma=0.5, observed=y, **dims),
    "EXP": lambda y, **dims: pmf.ExpFeature("y", mu=MU, sigma=0.5, observed=y, **dims),
    "GAMMA": lambda y, **dims: pmf.GammaFeature("y", mu=MU, sigma=0.5, m=[1, 2, 3], observed=y, **dims),
    "correlated": lambda y, **dims: pmf.CorrelatedNormal("y", MU, 0.5, 0.1, 0.02, observed=y, **dims),
    "ABC": lambda y, **dims: pmf.DiscrepancySimulator(
        "y", pmf.response(CHAIN, noise_record(3)), epsilon=0.5, kernel="gaussian", observed=y, **dims
    ),
    "ambient": ambient,
    "shapes": shapes,
}


def logp(likelihood, observed, coords=None, **dims):
    with pm.Model(coords=coords) as model:
        LIKELIHOODS[likelihood](observed, **dims)
    return float(model.compile_logp(mode="FAST_COMPILE")({}))


def values_for(likelihood):
    return RNG.normal(size=(3, 60)) if likelihood == "ambient" else VALUES


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:a record of", "ignore:the shapes of these")
@pytest.mark.parametrize("likelihood", LIKELIHOODS)
def test_turned_and_reordered_data_are_the_same_data(likelihood):
    axes = ("mode", "sensor") if likelihood == "shapes" else ("sensor", "time")
    values = values_for(likelihood)
    labelled = xr.DataArray(values, {"sensor": NAMES}, axes)
    right = logp(likelihood, values)
    assert logp(likelihood, labelled) == right
    assert logp(likelihood, labelled.transpose()) == right
    mixed = labelled.isel(sensor=[2, 0, 1]).transpose()
    assert logp(likelihood, mixed, {"sensor": NAMES}) == right
    assert logp(likelihood, mixed) != right  # no model that knows better


def test_names_of_the_user_s_own():
    right = logp("EXP", VALUES)
    own = {"floor": NAMES}
    labelled = xr.DataArray(VALUES, own, ("floor", "t")).isel(floor=[1, 2, 0])
    assert logp("EXP", labelled.transpose(), own, dims=("floor", "t")) == right
    called_sensor = labelled.rename(floor="sensor", t="time").transpose()
    assert logp("EXP", called_sensor, own, dims=("floor", "t")) == right
    assert logp("EXP", labelled.rename(t="time").transpose(), {"sensor": NAMES}) == right  # one unknown name
    assert logp("EXP", xr.DataArray(VALUES), {"sensor": NAMES}) == right  # none at all
    assert logp("EXP", labelled.isel(floor=[2, 0, 1]), {"floor": range(3)}, dims=("floor", "t")) == right


def test_numbers_that_say_the_place():
    right = logp("EXP", VALUES)
    labelled = xr.DataArray(VALUES, {"sensor": [0, 1, 2], "time": [5.0, 5.1, 5.2]}, ("sensor", "time"))
    assert logp("EXP", labelled[::-1], {"sensor": range(3)}) == right
    assert logp("EXP", labelled, {"sensor": NAMES}) == right


REFUSED = [
    (xr.DataArray(VALUES, dims=("kanal", "zeit")), r"must be along sensor, time, got kanal, zeit\. Rename"),
    (
        xr.DataArray(VALUES, {"sensor": ["roof", "third", "cellar"]}, ("sensor", "time")),
        r"the model's labels along sensor, roof, third, base, got roof, third, cellar\. Select and rename",
    ),
    (
        xr.DataArray(VALUES, {"sensor": ["roof", "third", "third"]}, ("sensor", "time")),
        "got roof, third, third",
    ),
    (
        xr.DataArray(VALUES, {"time": [0.2, 0.1, 0.0]}, ("sensor", "time")),
        r"increasing times, got others\. Sort them with observed\.sortby\(\"time\"\)",
    ),
]


@pytest.mark.parametrize(("observed", "said"), REFUSED)
def test_what_the_labels_contradict_is_refused(observed, said):
    with pytest.raises(ValueError, match=said):
        logp("EXP", observed, {"sensor": NAMES})


def test_data_of_the_model_along_turned_axes_are_refused():
    with pm.Model(coords={"sensor": NAMES, "time": [0.0, 0.1, 0.2]}):
        turned = pm.Data("measured", VALUES.T, dims=("time", "sensor"))
        with pytest.raises(
            ValueError, match=r"pm\.Data along sensor, time, got time, sensor\. Declare it in"
        ):
            pmf.ExpFeature("y", mu=MU, sigma=0.5, observed=turned)
        straight = pm.Data("right", VALUES, dims=("sensor", "time"))
        pmf.ExpFeature("y", mu=MU, sigma=0.5, observed=straight)


STAMPS = np.datetime64("2024-01-01", "ns") + np.arange(3) * np.timedelta64(40, "ms")


@pytest.mark.parametrize("times", [0.04 * np.arange(3), STAMPS])
def test_times_at_another_step_than_the_response_are_refused(times):
    data = xr.DataArray(VALUES, {"time": times}, ("sensor", "time"))
    right = xr.DataArray(VALUES, {"time": 0.02 * np.arange(3)}, ("sensor", "time"))
    with pm.Model():
        mu = pmf.response(CHAIN, noise_record(3))  # at 0.02 s
        with pytest.raises(ValueError, match="step of the response, 0.02 s, got times 0.04 s apart. Pass dt"):
            pmf.ExpFeature("y", mu=mu, sigma=0.5, observed=data)
        pmf.ExpFeature("y", mu=mu, sigma=0.5, observed=right)
