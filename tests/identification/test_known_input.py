"""Modes identified from channels and their excitation: intervals, close modes, shakers, hammers and bases."""

import numpy as np
import pytest
import xarray as xr

import pymc_features as pmf
from benchmarks.coverage import known_input
from benchmarks.coverage.known_input import BANDS, channels, earthquake, scores, shaken
from pymc_features.exceptions import AmbientWarning


@pytest.mark.statistical
@pytest.mark.slow
@pytest.mark.parametrize(("case", "runs"), [("earthquake", 3), ("free beam, hammer", 2)])
def test_deviations_are_as_large_as_said(case, runs):
    """Every mode once; deviations half or twice as large as said would fail (false alarms 1e-2)."""
    z = np.concatenate([np.concatenate([x.ravel() for x in scores(case, seed)]) for seed in range(runs)])
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.35


def test_close_modes_under_two_forces():
    """Both in each of 4 records; one of them started as a mode that is hardly damped, and stayed so."""
    z = [scores("close modes, shakers", seed) for seed in (1, 2, 3, 118)]
    assert max(np.abs(part).max() for record in z for part in record) < 5.0
    y, forces = shaken(1)
    found = pmf.identify_modes(y, [(0.8, 1.25)], n_modes=1, quantity="displacement", excitation=forces)
    assert found.frequencies.size == 1


@pytest.mark.slow
def test_narrow_bands_and_records_in_motion(monkeypatch):
    """No mode is lost to terms for those far away, and what neighbours move is taken off (5 sds)."""
    narrow = [(1.6, 2.3), (5.0, 6.1), (7.9, 9.0), (9.8, 11.0)]
    assert max(np.abs(x).max() for x in scores("earthquake", 1012, narrow)) < 5.0
    cases = {"earthquake": (lambda seed: earthquake(seed, "moving"), *known_input.CASES["earthquake"][1:])}
    monkeypatch.setattr(known_input, "CASES", cases)
    assert max(np.abs(x).max() for x in scores("earthquake", 1000)) < 5.0


def test_modal_masses():
    """A free beam of 1 kg hit where a channel is; modes there have a mean square of one (5 sds)."""
    y, force = known_input.hammered(1)
    found = pmf.identify_modes(y, BANDS["free beam, hammer"][:2], excitation=force)
    shapes = known_input.beam()[2][:2]
    expected = 1.0 / np.sum(shapes**2, axis=1)
    at_hit, parts = found.shapes[:, 1], found.participation[:, 0]
    relative = np.hypot(found.shape_sd[:, 1] / at_hit, found.participation_sd[:, 0] / parts)
    assert found.inputs == ("p1",)
    assert np.all(np.abs(found.modal_masses()[:, 0] / expected - 1.0) < 5.0 * relative)
    other = pmf.identify_modes(
        y, BANDS["free beam, hammer"][:1], excitation=force.assign_coords(sensor=["hammer"])
    )
    assert np.isnan(other.modal_masses()).all()
    with pytest.raises(ValueError, match="needs a `participation`"):
        pmf.modal.ModalData([1.0], [[1.0]], ["p1"]).modal_masses()
    assert found.select([1], ["p2"]).participation.shape == (1, 1)


def test_names_of_channels_say_the_same():
    """The excitation among the channels, or beside them."""
    floors, base = earthquake(1)
    one = pmf.identify_modes(floors, BANDS["earthquake"][:2], excitation=base)
    both = xr.concat([base, floors], "sensor")
    other = pmf.identify_modes(both, BANDS["earthquake"][:2], excitation="g")
    np.testing.assert_allclose(other.frequencies, one.frequencies, rtol=1e-12)
    assert other.channels == one.channels


def test_what_is_refused():
    """Excitations that do not fit; a band of noise is named."""
    floors, base = earthquake(1)
    with pytest.raises(ValueError, match="`excitation` must be some of the channels a, b, c, d"):
        pmf.identify_modes(floors, BANDS["earthquake"], excitation="base")
    with pytest.raises(ValueError, match="`excitation` must be .* samples at 0.02 s"):
        pmf.identify_modes(floors, BANDS["earthquake"], excitation=base.isel(time=slice(None, None, 2)))
    noise = channels(np.random.default_rng(1).standard_normal((2, 3000)), "ab", 50.0)
    with (
        pytest.warns(AmbientWarning, match="has no mode"),
        pytest.raises(ValueError, match="bands with modes"),
    ):
        pmf.identify_modes(noise, [(2.0, 4.0)], excitation=base.isel(time=slice(3000)))
