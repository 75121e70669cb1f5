"""Structures whose published updates are known: a footbridge with its finite elements, and a frame."""

import json
import warnings

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
import xarray as xr
from scipy.linalg import eigh

import pymc_features as pmf
from pymc_features.datasets import footbridge
from pymc_features.exceptions import DatasetUnavailableError, ModalMatchWarning
from support.graphs import LIGHT, PLAIN


@pytest.fixture(scope="module")
def published(reference_dir):
    return json.loads((reference_dir / "modal_published.json").read_text())


@pytest.fixture(scope="module")
def bridge(data_dir):
    try:
        return footbridge()
    except DatasetUnavailableError as error:
        pytest.skip(str(error))


def finite_elements(bridge, alpha):
    """K(alpha) = sum_i (1 + alpha_i) K_i, 946 degrees of freedom, 474 of them without mass."""
    parts = list(bridge.stiffness_parts.values())
    structure = pmf.AffineStructure(
        bridge.mass,
        stiffness=sum(parts[1:], parts[0]),
        damping=pmf.ModalDamping(0.01),
        stiffness_terms=parts,
        theta=np.zeros(17),
    )
    return structure.with_parameters(alpha)


@pytest.fixture(scope="module")
def bridge_modes(bridge):
    """Frequencies [Hz] and shapes of eight modes at alpha."""
    alpha = pt.vector("alpha", shape=(17,))
    found = pmf.modes(finite_elements(bridge, alpha), 8, sensors=bridge.measured)
    return pytensor.function([alpha], [found.frequencies, found.shapes], mode=PLAIN)


@pytest.mark.parametrize("name", ["nominal", "published_optimum_mac", "published_optimum_vector"])
def test_modes_of_the_footbridge_are_the_published_ones(name, bridge, bridge_modes, published):
    """Frequencies and modal assurance criteria, to 1e-6."""
    expected = published["footbridge"][name]
    frequencies, shapes = bridge_modes(expected.get("alpha", np.zeros(17)))
    n = len(expected["frequencies_hz"])
    np.testing.assert_allclose(frequencies[:n], expected["frequencies_hz"], rtol=1e-6)
    taken = expected.get("best_match", range(5))
    values = pmf.modal.mac(bridge.modal.shapes, shapes)
    np.testing.assert_allclose(values[range(5), list(taken)], expected["mac"], rtol=1e-6)


def bridge_model(bridge, sigma_f):
    with warnings.catch_warnings(), pm.Model() as model:
        warnings.simplefilter("ignore", ModalMatchWarning)
        alpha = pm.Normal("alpha", 0.0, 0.3, shape=17)
        found = pmf.modes(finite_elements(bridge, alpha), 8, sensors=bridge.measured)
        pmf.ModalFeature("y", found, observed=bridge.modal, sigma_f=sigma_f, sigma_phi=0.2)
    return model


@pytest.mark.slow
def test_the_swapped_modes_of_the_footbridge_are_matched(bridge, published):
    """By their shapes nominally, where frequencies say little; in their order at both optima."""
    own = published["footbridge"]
    optima = [own[name]["alpha"] for name in ("published_optimum_mac", "published_optimum_vector")]
    points = xr.Dataset({"alpha": (("chain", "draw", "part"), np.array([[np.zeros(17), *optima]]))})
    tables = {
        s: pmf.modal.match_modes(points, model=bridge_model(bridge, s)).isel(chain=0) for s in (0.003, 0.2)
    }
    np.testing.assert_array_equal(tables[0.2]["model_mode"][0], own["nominal"]["best_match"])
    for table in tables.values():
        np.testing.assert_array_equal(table["model_mode"][1:], [range(5)] * 2)
        assert (table["mac"][1:] > 0.88).all() and table["has_partner"][1:].all()


def test_gradient_of_the_likelihood_of_the_footbridge(bridge, published):
    """Along a direction, at an optimum and beside it, against Richardson's differences."""
    model = bridge_model(bridge, 0.003)
    [value] = model.value_vars
    outputs = [model.logp(), model.dlogp()]
    function = pytensor.function([value], outputs, mode=LIGHT)
    optimum = np.array(published["footbridge"]["published_optimum_mac"]["alpha"])
    direction = np.random.default_rng(5).normal(size=17) * (1.0 + optimum)
    for point in (optimum, optimum + 0.03 * direction):
        d = [
            (function(point + h * direction)[0] - function(point - h * direction)[0]) / (2 * h)
            for h in (2e-4, 1e-4)
        ]
        assert function(point)[1] @ direction == pytest.approx((4 * d[1] - d[0]) / 3, rel=1e-6)


SIGMA_F, SHAPE, RATE = 0.005, 3.0, 0.002  # sigma_phi^2 ~ InverseGamma(SHAPE, RATE)
FACTORS = 0.3  # standard deviation of the logarithm of a stiffness factor


def frame_density(factors, frame, measured):
    """Log-density of stiffness factors (4,), by SciPy; sigma_phi^2 is integrated out.

    Two shapes of two degrees of freedom each: (RATE + sum(1 - MAC) / 2)^-(SHAPE + 2).
    """
    k = frame["nominal"]["stiffness_lbf_per_in"] * factors
    stiffness = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    values, shapes = eigh(stiffness / frame["nominal"]["mass_lbf_s2_per_in"])
    frequencies = np.sqrt(values[:2]) / (2.0 * np.pi)
    a, b = shapes[:3, :2].T, measured["shapes"]
    e = 1.0 - (a * b).sum(axis=1) ** 2 / (a**2).sum(axis=1) / (b**2).sum(axis=1)
    z = np.log(measured["frequencies"] / frequencies) / SIGMA_F
    prior = np.log(factors) / FACTORS
    return -0.5 * (z @ z + prior @ prior) - (SHAPE + 2.0) * np.log(RATE + 0.5 * e.sum())


@pytest.mark.slow
def test_posterior_of_a_frame_contains_the_published_optima(published):
    """In the region of highest density with 90 % of the draws; not the nominal model, nor one apart."""
    frame = published["four_storey"]
    shapes = np.array(frame["shapes_columns_are_modes"])
    measured = {"frequencies": np.array(frame["frequencies_hz"][:2]), "shapes": shapes[:3, :2].T}
    with pm.Model():
        factors = pm.LogNormal("factors", 0.0, FACTORS, shape=4)
        variance = pm.InverseGamma("variance", SHAPE, RATE)
        stiffness = frame["nominal"]["stiffness_lbf_per_in"] * factors
        mass = np.full(4, frame["nominal"]["mass_lbf_s2_per_in"])
        found = pmf.modes(pmf.SpringMassChain(mass, stiffness, pmf.ModalDamping(0.0)), sensors=[0, 1, 2])
        pmf.ModalFeature("y", found, observed=measured, sigma_f=SIGMA_F, sigma_phi=pt.sqrt(variance))
        quiet = {"cores": 1, "random_seed": 1, "progressbar": False, "compile_kwargs": {"mode": LIGHT}}
        idata = pmf.sample(1000, chains=2, check=None, **quiet)
    assert idata.sample_stats.attrs["advice"] == ""
    draws = idata.posterior["factors"].values.reshape(-1, 4)
    densities = np.array([frame_density(x, frame, measured) for x in draws])

    def region(alpha):
        """Share of the draws in the smallest region of highest density that contains a point."""
        return (densities > frame_density(1.0 + np.array(alpha), frame, measured)).mean()

    optima = [frame[f"published_optimum_{kind}"]["alpha"] for kind in ("mac", "vector", "residual")]
    changes = abs(np.array(optima))
    assert (changes.max(axis=0) / changes.min(axis=0)).max() == pytest.approx(1.25, abs=0.01)
    assert max(region(alpha) for alpha in optima) < 0.9
    assert region(np.zeros(4)) > 0.99
    assert region(np.array(optima[0]) + [0.3, 0.0, 0.0, 0.0]) > 0.99
