"""Sensors by the names of degrees of freedom, wherever there are sensors."""

import numpy as np
import pytest
import xarray as xr

import pymc_features as pmf
from pymc_features import LinearStructure, ModalDamping, SpringMassChain, simulate
from support.structures import noise_record

NAMES = ["1:x", "2:x", "roof:x"]
CHAIN = SpringMassChain([2.0, 2.0, 1.0], [900.0, 800.0, 700.0], ModalDamping(0.03))
RECORD = noise_record(60)


def frame(stiffness=1.0):
    mass, damping, matrix = CHAIN.matrices()
    structure = LinearStructure(mass, stiffness=stiffness * matrix, damping=ModalDamping(0.03))
    return structure.with_names(NAMES)


def test_responses_by_name_are_those_by_number():
    by_name = simulate(frame(), RECORD, sensors=["roof:x", "1:x"])
    np.testing.assert_array_equal(by_name.values, simulate(frame(), RECORD, sensors=[2, 0]).values)
    assert by_name["sensor"].values.tolist() == ["roof:x", "1:x"]
    assert by_name.sel(sensor="1:x").attrs["units"] == "m/s^2"
    np.testing.assert_array_equal(
        simulate(frame(), RECORD, sensors="2:x").values[0], simulate(frame(), RECORD, sensors=[1]).values[0]
    )
    in_model = pmf.response(frame(), RECORD, sensors=["roof:x", "1:x"]).eval()
    np.testing.assert_allclose(in_model, by_name.values, rtol=1e-12, atol=1e-12)
    shapes = pmf.modes(frame(), sensors=["roof:x", "1:x"]).shapes.eval()
    np.testing.assert_allclose(shapes, frame().modes().mode_shapes[[2, 0]].T, atol=1e-12)


def test_predictions_have_the_names():
    """Also where a base shear, which has no sensors, is predicted with them."""
    posterior = xr.Dataset({"stiffness": (("chain", "draw"), [[1.0, 1.0, 1.0]])})
    quantities = ["base_shear", "relative_displacement"]
    bands = pmf.prediction.posterior_response(
        posterior, frame, RECORD, quantities, sensors=["roof:x"], draws=3
    )
    assert bands["sensor"].values.tolist() == ["roof:x"]
    expected = simulate(frame(), RECORD, sensors=[2], quantity="relative_displacement").values
    found = bands["relative_displacement"].sel(quantile=0.5)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15 * abs(expected).max())


def test_names_stay_with_other_parameters():
    mass, _, matrix = CHAIN.matrices()
    structure = pmf.AffineStructure(
        mass, stiffness=0.0 * matrix, damping=ModalDamping(0.03), stiffness_terms=[matrix], theta=[1.0]
    ).with_names(NAMES)
    assert structure.with_parameters([2.0]).dof_names == tuple(NAMES)


@pytest.mark.parametrize(
    "structure, sensors, message",
    [
        (frame(), ["rof:x"], "among 1:x, 2:x, roof:x, got 'rof:x'. Is roof:x meant?"),
        (frame(), ["zzzz"], "among 1:x, 2:x, roof:x, got 'zzzz'. Name degrees of freedom, or give their"),
        (frame(), ["1:x", 2], "all names or all numbers"),
        (
            CHAIN,
            ["1:x"],
            r"a list .* \(integers\) of a SpringMassChain without names, got .* by `with_names`",
        ),
    ],
)
def test_refusals(structure, sensors, message):
    for function in (
        lambda: simulate(structure, RECORD, sensors=sensors),
        lambda: pmf.response(structure, RECORD, sensors=sensors),
        lambda: pmf.modes(structure, sensors=sensors),
    ):
        with pytest.raises((ValueError, TypeError), match=f"`sensors` must be {message}"):
            function()


@pytest.mark.parametrize(
    "names, message",
    [
        (["a", "b", "a"], "`names` must be 3 different texts, got 'a' twice"),
        ("abc", "`names` must be 3 texts"),
    ],
)
def test_refused_names(names, message):
    with pytest.raises((ValueError, TypeError), match=message):
        frame().with_names(names)
