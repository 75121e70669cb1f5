"""Files that are written are read back equal."""

import numpy as np
import pytest
import xarray as xr

import pymc_features as pmf
from support.refusals import refusals

RNG = np.random.default_rng(5)
VALUES = RNG.normal(size=(2, 300))


def channels(start=0.0, step=0.005, names=("1X", "12-Z"), units="m/s^2", values=VALUES):
    coords = {"sensor": list(names), "time": step * np.arange(values.shape[1])}
    return xr.DataArray(values, coords, ("sensor", "time"), attrs={"units": units, "start": start})


@pytest.mark.parametrize("ending", ["csv", "txt", "uff", "unv"])
@pytest.mark.parametrize("start", [0.0, 991.5])
@pytest.mark.parametrize("step", [0.005, 1.0 / 120.0])
def test_channels(tmp_path, ending, start, step):
    given, path = channels(start, step), tmp_path / f"frame.{ending}"
    pmf.io.write_channels(given, path)
    found = pmf.read_channels(path)
    np.testing.assert_array_equal(found.values, given.values)
    np.testing.assert_allclose(found["time"], given["time"], rtol=1e-9)
    assert list(found["sensor"].values) == ["1X", "12-Z"]
    if ending in ("csv", "txt"):
        assert found.attrs == given.attrs


def test_dates_and_gaps(tmp_path):
    """Clocks that count from 1970 become time stamps, NaN empty cells."""
    values = np.where(RNG.random(VALUES.shape) < 0.1, np.nan, VALUES)
    values[:, 0] = VALUES[:, 0]
    given = channels(1715990390.25, values=values, names=("base, north", "roof"))
    pmf.io.write_channels(given, tmp_path / "frame.csv")
    assert "2024-05-17T23:59:50.25" in (tmp_path / "frame.csv").read_text()
    found = pmf.io.read_channels_with_gaps(tmp_path / "frame.csv")
    np.testing.assert_array_equal(found.values, values)
    assert found.attrs["start"] == 1715990390.25
    assert list(found["sensor"].values) == ["base, north", "roof"]


NOT_WRITTEN = {
    r"`path` must be a file ending in .csv, .txt, .uff, .unv, got frame.mat": (channels(), "frame.mat"),
    "named by node and direction, as 12Z, for a Universal": (channels(names=("1X", "roof")), "frame.uff"),
    r"must be without gaps for frame.uff": (channels(values=VALUES * [[1.0], [np.nan]])[:1], "frame.uff"),
    "`channels` must be names of sensors without brackets": (channels(names=("a [1]", "b")), "frame.csv"),
}


@refusals("given name", NOT_WRITTEN)
def test_channels_that_are_not_written(tmp_path, given, name, match):
    if "gaps" in match:
        given = given.copy()
        given[0, 3] = np.nan
    with pytest.raises(ValueError, match=match):
        pmf.io.write_channels(given, tmp_path / name)


def modes(complex_=False, **changes):
    shapes = np.array([[0.6, 1.0, 0.2], [1.0, np.nan, -0.4]])
    shapes = shapes * np.exp(0.1j * np.arange(3)) if complex_ else shapes
    given = {"damping_ratios": [0.01, np.nan], "frequency_sd": [0.01, 0.02]} | changes
    return pmf.modal.ModalData([1.25, 3.5], shapes, ["1X", "2Z", "10Y"], **given)


@pytest.mark.parametrize("complex_", [False, True])
@pytest.mark.parametrize("ending", ["csv", "json"])
def test_modes(tmp_path, ending, complex_):
    given = modes(complex_, shape_sd=0.1 * np.ones((2, 3)), damping_sd=[0.001, np.nan])
    pmf.modal.write_modal(given, tmp_path / f"modes.{ending}")
    found = pmf.read_modal(tmp_path / f"modes.{ending}", real=False)
    for name in ("frequencies", "shapes", "frequency_sd", "damping_ratios", "damping_sd", "shape_sd"):
        np.testing.assert_array_equal(getattr(found, name), getattr(given, name))
    assert found.channels == given.channels


@pytest.mark.parametrize("complex_", [False, True])
def test_modes_of_a_universal_file(tmp_path, complex_):
    """Six digits, as data sets 55 have; another reader finds the same."""
    given = modes(complex_, damping_ratios=[0.01, 0.02])
    pmf.modal.write_modal(given, tmp_path / "modes.uff")
    found = pmf.read_modal(tmp_path / "modes.uff", real=False)
    order = [found.channels.index(name) for name in given.channels]
    np.testing.assert_allclose(found.frequencies, given.frequencies, rtol=1e-5)
    np.testing.assert_allclose(found.damping_ratios, given.damping_ratios, rtol=1e-4)
    np.testing.assert_allclose(np.asarray(found.shapes)[:, order], given.shapes, rtol=1e-5, atol=1e-9)
    import pyuff

    theirs = pyuff.UFF(str(tmp_path / "modes.uff")).read_sets()
    assert [one["type"] for one in theirs] == [55, 55]


def test_labels_of_modes(tmp_path):
    given = pmf.modal.ModalData([1.2, 1.21, 3.5], labels=["a", "a", "b"])
    pmf.modal.write_modal(given, tmp_path / "modes.csv")
    assert list(pmf.read_modal(tmp_path / "modes.csv").labels) == ["a", "a", "b"]
    with pytest.raises(ValueError, match=r"a table \(.csv\) for modes with labels"):
        pmf.modal.write_modal(given, tmp_path / "modes.json")


def test_modes_that_are_not_written(tmp_path):
    with pytest.raises(TypeError, match="`modal` must be a ModalData, got dict"):
        pmf.modal.write_modal({}, tmp_path / "modes.csv")
    with pytest.raises(ValueError, match="channels named by node and direction"):
        pmf.modal.write_modal(pmf.modal.ModalData([1.0], [[1.0]], ["roof"]), tmp_path / "modes.uff")
