"""A measured footbridge whose first two modes are swapped against its finite elements."""

import os
from pathlib import Path

import numpy as np
import pymc as pm
import pytest
import xarray as xr

from pymc_features import AffineStructure, ModalDamping, ModalFeature, datasets, mac, match_modes, modes

DATA = Path(os.environ.get("PYMC_FEATURES_DATA", "nowhere")) / "modal" / "footbridge"
NOMINAL_MAC = [
    0.97061,
    0.98583,
    0.95470,
    0.96573,
    0.90303,
]  # of the published model, by the published matrices
OPTIMUM = np.array(  # published, for frequencies and MAC
    [-0.1, -0.0508396, 0.4, *[-0.2] * 9, 0.4, -0.7163167, 6.4892739, -0.0911697, 10.0]
)
OPTIMUM_MAC = [0.93439, 0.97987, 0.93991, 0.91742, 0.88420]
LOWER, UPPER = np.repeat([-0.1, -0.2, -1.0], [2, 11, 4]), np.repeat([0.1, 0.4, 10.0], [2, 11, 4])


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="needs PYMC_FEATURES_DATA/modal/footbridge")
def test_the_swapped_pair_is_matched_right_in_every_draw_that_fits():
    bridge = datasets.footbridge()
    parts = list(bridge.stiffness_parts.values())
    nominal = AffineStructure(
        bridge.mass,
        stiffness=sum(parts[1:], parts[0]),
        damping=ModalDamping(0.01),
        stiffness_terms=parts,
        theta=np.zeros(17),
    )
    with pm.Model() as model:
        alpha = pm.Uniform("alpha", LOWER, UPPER, shape=17, initval=np.zeros(17))
        found = modes(nominal.with_parameters(alpha), 8, sensors=bridge.measured)
        ModalFeature("y", found, observed=bridge.modal, sigma_f=0.1, sigma_phi=0.1)
    rng = np.random.default_rng(0)
    between = np.concatenate([[0.0, 1.0], rng.uniform(0.0, 1.0, 28)])[:, None] * OPTIMUM
    between[2:] += 0.03 * rng.standard_normal((28, 17)) * (UPPER - LOWER)
    draws = np.clip(between, LOWER, UPPER)
    posterior = xr.Dataset({"alpha": (("chain", "draw", "i"), draws[None])})
    table = match_modes(posterior, model=model, least_mac=0.8)
    table = table.isel(chain=0)
    np.testing.assert_array_equal(table["model_mode"][0], [1, 0, 2, 3, 4])
    np.testing.assert_allclose(table["mac"][0], NOMINAL_MAC, atol=1e-4)
    np.testing.assert_array_equal(table["model_mode"][1], [0, 1, 2, 3, 4])
    np.testing.assert_allclose(table["mac"][1], OPTIMUM_MAC, atol=1e-4)
    fits = np.flatnonzero(table["has_partner"].all("mode"))
    assert fits.size >= 6
    for d in fits:
        shapes = nominal.with_parameters(draws[d]).modes(8).mode_shapes[bridge.measured].T
        np.testing.assert_array_equal(table["model_mode"][d], mac(shapes, bridge.modal.shapes).argmax(axis=0))
    assert len(set(map(tuple, table["model_mode"].values[fits]))) > 1  # both orders are among them
