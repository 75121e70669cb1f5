"""match_modes: which mode each measured mode was matched with, and what has no partner."""

import warnings

import numpy as np
import pymc as pm
import pytest
import xarray as xr

from pymc_features import AffineStructure, ModalDamping, ModalFeature, modes
from pymc_features.exceptions import ModalMatchWarning
from pymc_features.modal import match_modes

X = np.array([[2.0, -1.0], [-1.0, 1.0]])
ZERO = np.zeros((2, 2))


def column(theta):
    """A column of two storeys in x and y; theta are the stiffnesses."""
    terms = [np.block([[X, ZERO], [ZERO, ZERO]]), np.block([[ZERO, ZERO], [ZERO, X]])]
    return AffineStructure(
        np.ones(4), stiffness=np.zeros((4, 4)), damping=ModalDamping(0.0), stiffness_terms=terms, theta=theta
    )


def measured(theta, picked=(0, 1, 2), noise=0.0):
    found = column(theta).modes()
    rng = np.random.default_rng(2)
    shapes = found.mode_shapes.T[list(picked)]
    return {
        "frequencies": found.natural_frequencies[list(picked)],
        "shapes": -3.0 * shapes + noise * rng.normal(size=shapes.shape),
    }


def posterior_of(values):
    return xr.Dataset({"theta": (("chain", "draw", "i"), np.asarray(values)[None])})


def test_swapped_modes_are_matched_in_every_draw():
    """Measured with x softer than y; the model starts with x stiffer, its first mode the measured second."""
    with pm.Model() as model, warnings.catch_warnings():
        warnings.simplefilter("error", ModalMatchWarning)
        theta = pm.LogNormal("theta", np.log([130.0, 100.0]), 0.2, shape=2)
        ModalFeature(
            "y", modes(column(theta), 4), observed=measured([100.0, 110.0]), sigma_f=0.2, sigma_phi=0.1
        )
    table = match_modes(model=model)
    np.testing.assert_array_equal(table["model_mode"], [1, 0, 3])
    np.testing.assert_allclose(table["mac"], 1.0, rtol=1e-12)
    assert table["has_partner"].all() and list(table["mode"].values) == ["0", "1", "2"]
    draws = np.array([[90.0, 110.0], [130.0, 100.0], [100.0, 110.0]])
    table = match_modes(posterior_of(draws), model=model)
    assert table["model_mode"].dims == ("chain", "draw", "mode")
    np.testing.assert_array_equal(table["model_mode"][0], [[0, 1, 2], [1, 0, 3], [0, 1, 2]])
    for d, values in enumerate(draws):
        f = column(values).modes().natural_frequencies[table["model_mode"].values[0, d]]
        np.testing.assert_allclose(table["frequency"].values[0, d], f, rtol=1e-12)
        off = np.log(measured([100.0, 110.0])["frequencies"] / f) / 0.2
        np.testing.assert_allclose(table["deviation"].values[0, d], off, rtol=1e-9, atol=1e-12)


def test_a_mode_without_a_partner_is_said():
    """By its shape when the model is declared, by frequency and shape when asked."""
    data = measured([100.0, 110.0], (0, 1, 2))
    data["shapes"][1] = [1.0, -2.0, 1.5, 0.3]  # like none
    data["frequencies"][2] *= 1.5  # like none
    with (
        pm.Model() as model,
        pytest.warns(ModalMatchWarning, match=r"no partner .* initial point: 1 \(MAC 0\."),
    ):
        theta = pm.LogNormal("theta", np.log([100.0, 110.0]), 0.1, shape=2)
        ModalFeature("y", modes(column(theta), 4), observed=data, sigma_f=0.05, sigma_phi=0.1)
    with pytest.warns(ModalMatchWarning) as caught:
        table = match_modes(model=model)
    np.testing.assert_array_equal(table["has_partner"], [True, False, False])
    assert "mode 1 of y has no partner in the model: the best that is left is at" in str(caught[0].message)
    assert "mode 2 of y" in str(caught[1].message)
    with pytest.warns(ModalMatchWarning, match="in 100% of the draws"):
        match_modes(posterior_of([[100.0, 110.0]] * 2), model=model)


def test_frequencies_alone_have_no_mac():
    with pm.Model() as model:
        theta = pm.LogNormal("theta", np.log([100.0, 110.0]), 0.1, shape=2)
        ModalFeature(
            "y", modes(column(theta), 4), observed=measured([100.0, 110.0])["frequencies"], sigma_f=0.05
        )
    table = match_modes(model=model)
    assert np.isnan(table["mac"]).all() and table["has_partner"].all()


def test_refusals():
    with pm.Model() as model:
        theta = pm.LogNormal("theta", np.log([100.0, 110.0]), 0.1, shape=2)
        for name in "ab":
            ModalFeature(name, modes(column(theta), 4), observed=[1.0], sigma_f=10.0)
    with pytest.raises(
        ValueError, match="`name` must be that of one ModalFeature of the model, got None: a, b"
    ):
        match_modes(model=model)
    with pytest.raises(ValueError, match="`posterior` must have all free variables"):
        match_modes(xr.Dataset(), model=model, name="a")
    assert match_modes(model=model, name="a")["model_mode"].shape == (1,)
