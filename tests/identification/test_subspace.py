"""Subspace identification by pyOMA2 beside modes identified here: poles, scores, and the diagram."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import pymc_features as pmf
from benchmarks.coverage.known_input import BANDS, earthquake
from pymc_features.ambient import subspace


@pytest.fixture(scope="module")
def shaken():
    """Floors and base of one earthquake, and their modes."""
    floors, base = earthquake(1)
    return floors, base, pmf.identify_modes(floors, BANDS["earthquake"], excitation=base)


@pytest.mark.statistical
def test_both_identifications_agree(shaken):
    """All four modes, within four joint standard deviations; none where shapes are not those of the poles."""
    pytest.importorskip("pyoma2")
    floors, base, modes = shaken
    poles = subspace.subspace_poles(floors, base, lowest=modes.frequencies[0], order=40)
    found = subspace.second_opinion(modes, poles)
    assert np.abs(found[["z_frequency", "z_damping"]].to_array()).max() < 4.0  # false alarms 5e-4
    assert (found["n_orders"] > 10).all()
    np.testing.assert_allclose(found["frequency"], modes.frequencies, rtol=0.01)
    turned = replace(modes, shapes=modes.shapes[::-1])
    assert (subspace.second_opinion(turned, poles)["n_orders"] == 0).all()
    assert "mode 1: 1.9" in (told := list(subspace.opinion_on(modes, floors, base)))[0]
    assert len(told) == 4 and all("subspace identification (pyOMA2) has" in line for line in told)


def test_diagram(shaken):
    """Stable poles stand on the bands of the modes, at every order above some."""
    pytest.importorskip("pyoma2")
    floors, base, modes = shaken
    poles = pmf.ambient.subspace_poles(floors, base, lowest=modes.frequencies[0], order=20)
    [ax] = pmf.plots.stabilisation(poles, modes)
    stable = ax.containers[0].lines[0]
    f, order = stable.get_data()
    for mode in modes.frequencies:
        near = np.abs(f / mode - 1.0) < 0.01
        assert set(order[near]) >= set(range(14, 21))
    assert len(ax.patches) == 4
    pmf.plots.close([ax])


def test_what_is_refused(shaken, monkeypatch):
    """Modes of another kind; pyOMA2 that is missing."""
    floors, _, _ = shaken
    with pytest.raises(TypeError, match=r"`modes` must be `modal.ModalData`, got"):
        names = ["order", "frequency", "frequency_sd", "is_stable"]
        pmf.plots.stabilisation(xr.Dataset(dict.fromkeys(names, 1.0)), [1.0])
    with pytest.raises(TypeError, match="`poles` must be a Dataset"):
        pmf.plots.stabilisation(floors)
    with pytest.raises(ValueError, match="`order` must be"):
        pmf.ambient.subspace_poles(floors, order=1)
    with pytest.raises(ValueError, match="`lowest` must be"):
        pmf.ambient.subspace_poles(floors, lowest=0.0)
    monkeypatch.setattr(subspace, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"needs pyOMA2: pip install pyOMA_2\."):
        pmf.ambient.subspace_poles(floors)
