"""Long histories stay readable, and long names are not cut."""

import numpy as np
import pytest
import xarray as xr

from pymc_features import Record, plots

QUANTILES = [0.05, 0.5, 0.95]


def updated(time, frequency, noise=0.1, around=0.2, names=("floor1", "floor2")):
    """A made-up likelihood of an update: an oscillation [Hz] that grows and decays, measured with noise."""
    middle = np.sin(np.pi * time / time[-1]) * np.sin(2.0 * np.pi * frequency * time)
    middle = middle * np.arange(1.0, len(names) + 1.0)[:, None]
    observed = middle + noise * np.random.default_rng(3).uniform(-1.0, 1.0, middle.shape)
    dims, coords = ("sensor", "time"), {"sensor": list(names), "time": time}
    bands = {
        name: (("quantile", *dims), middle + np.array([-width, 0.0, width])[:, None, None])
        for name, width in (("response", 0.05), ("predictive", around))
    }
    bands["normalised_error"] = "sensor", np.full(len(names), 0.1)
    parts = {
        "bands": xr.Dataset(bands, coords={"quantile": QUANTILES} | coords),
        "observed_data": xr.Dataset({"y": (dims, observed)}, coords=coords),
    }
    return xr.DataTree.from_dict(parts)


LONG = 0.01 * np.arange(20_001)


def areas(ax):
    """Corners (2, n) of the areas on an axis, by their labels."""
    return {area.get_label(): area.get_paths()[0].vertices.T for area in ax.collections}


def test_long_records_are_drawn_by_their_envelopes():
    """5 Hz for 200 s: 1000 oscillations on 700 pixels."""
    idata = updated(LONG, 5.0)
    axes = plots.predictive(idata)
    observed, drawn = idata["observed_data"]["y"].values[1], areas(axes[1])
    assert "measured" not in {line.get_label() for line in axes[1].lines}
    corners = drawn["measured"][1]
    assert (corners.min(), corners.max()) == (observed.min(), observed.max())
    lower, upper = axes[1].lines
    pixels = axes[1].get_window_extent().width
    assert 0.5 * pixels < lower.get_xdata().size <= pixels
    # the ends of the response, near the middle where it is largest; between them lies what was measured
    amplitude = 2.0 * np.sin(np.pi * LONG / LONG[-1])
    for line, sign in ((lower, -1.0), (upper, 1.0)):
        inner = slice(10, -10)
        end = sign * np.interp(line.get_xdata(), LONG, amplitude)[inner]
        np.testing.assert_allclose(line.get_ydata()[inner], end, atol=0.15)
    # the uncertainty of the response is a narrow band at each end, and hides nothing between them
    bands = [area for area in axes[1].collections if area.get_alpha() == 0.4]
    heights = [np.ptp(area.get_paths()[0].vertices[:, 1]) for area in bands]
    assert len(bands) == 2 and max(heights) < 2.3


def test_long_records_of_slow_structures_keep_their_lines():
    """0.2 Hz for 200 s: 40 oscillations, each wide enough; the noise of 20,000 samples is below the line."""
    idata = updated(LONG, 0.2)
    axes = plots.predictive(idata)
    [line] = axes[0].lines
    np.testing.assert_array_equal(line.get_ydata(), idata["bands"]["response"].values[1, 0])
    measured = next(area for area in axes[0].collections if area.get_label() == "measured")
    assert measured.get_zorder() < line.get_zorder()
    [zoomed] = plots.predictive(idata, "floor2", window=(90.0, 94.0))
    assert [line.get_label() for line in zoomed.lines] == ["median response", "measured"]


def test_response_bands_of_long_records():
    """What was measured for half the time is drawn with columns of the same width."""
    idata = updated(LONG, 5.0)
    result = idata["bands"].to_dataset().rename(response="absolute_acceleration")
    measured = idata["observed_data"]["y"].isel(time=slice(10_000)).sel(sensor=["floor2"])
    axes = plots.response(result, "absolute_acceleration", measured=measured)
    assert [len(ax.lines) for ax in axes] == [2, 2]
    corners = areas(axes[1])["measured"]
    assert corners[0].max() == pytest.approx(99.99)
    assert np.unique(corners[0]).size == pytest.approx(0.5 * axes[1].lines[0].get_xdata().size, abs=2)
    assert "measured" not in areas(axes[0])


def test_wide_errors_leave_the_response_readable():
    """A predictive band of 100 m/s^2 around a response of 2 takes two thirds of the height, not all."""
    time = LONG[:500]
    [ax] = plots.predictive(updated(time, 1.0, around=100.0), "floor2")
    low, high = ax.get_ylim()
    assert 2.5 * 4.0 < high - low < 3.5 * 4.0
    [ax] = plots.predictive(updated(time, 1.0, around=0.5), "floor2")
    low, high = ax.get_ylim()
    assert low < -2.4 and high > 2.4  # all of a band that is not wide


NAME = "Sensor 7 on the fourth floor beside the north-eastern column, accelerometer of the second campaign, "


def is_inside(text):
    """Whether a drawn text is inside its figure."""
    extent, frame = text.get_window_extent(), text.figure.bbox
    return extent.x0 >= frame.x0 and extent.x1 <= frame.x1


@pytest.mark.slow
@pytest.mark.parametrize("name", [3 * NAME, "RSN6_IMPVALL.I_I-ELC$^{180_" * 9])
def test_long_titles_are_broken(name):
    """At words if there are any, and none is taken for a formula."""
    record = Record(np.sin(LONG[:300]), 0.01, name=name)
    channels = xr.DataArray(
        [record.acceleration], {"sensor": [name], "time": record.time}, ("sensor", "time")
    )
    figures = [
        plots.record(record),
        plots.channels(channels),
        plots.predictive(updated(LONG[:300], 1.0, names=(name, "roof"))),
    ]
    for axes in figures:
        [ax, *_] = axes
        ax.figure.canvas.draw()
        title = next(t for t in (ax.title, ax._left_title) if t.get_text())
        assert title.get_text().count("\n") >= 1
        assert is_inside(title)
        letters = "".join(title.get_text().split())
        assert letters.startswith("".join(name.split()))
        assert title.get_window_extent().y1 <= ax.figure.bbox.y1


def test_long_names_of_parameters_are_broken():
    draws = {"stiffness_of_the_storeys_below_the_transfer_beam": (("chain", "draw"), np.arange(100.0)[None])}
    idata = xr.DataTree.from_dict({"posterior": xr.Dataset(draws), "prior": xr.Dataset(draws)})
    [ax] = plots.prior_posterior(idata, units=dict.fromkeys(draws, "N/m"))
    ax.figure.canvas.draw()
    assert is_inside(ax.xaxis.label)
    assert "".join(ax.get_xlabel().split()) == f"{next(iter(draws))}[N/m]"
