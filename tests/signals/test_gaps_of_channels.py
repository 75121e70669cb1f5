"""Processing of channels with gaps: what is left is what it is without them."""

import warnings

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import binary_dilation

from pymc_features import datasets, signals
from pymc_features.signals.channels import filled, widened
from support.warned import messages

STEP = 0.01
N = 3000


def array(values):
    values = np.atleast_2d(values)
    coords = {"sensor": [f"s{i}" for i in range(len(values))], "time": STEP * np.arange(values.shape[1])}
    return xr.DataArray(values, coords, ("sensor", "time"), attrs={"units": "m/s^2"})


def motion(seed=0, n_sensors=3):
    """Narrow-banded motions of 2 to 6 Hz that grow and decay."""
    rng, time = np.random.default_rng(seed), STEP * np.arange(N)
    frequency, phase = rng.uniform(2.0, 6.0, (2, n_sensors, 8, 1)) * [[[[1.0]]], [[[5.0]]]]
    shape = np.exp(-(((time - 14.0) / 8.0) ** 2))
    return shape * np.sin(2.0 * np.pi * frequency * time + phase).sum(axis=1)


def planted(values):
    """Half a second at the strongest motion of one sensor, and the end of another."""
    values = values.copy()
    values[1, 1400:1450] = np.nan
    values[2, -200:] = np.nan
    return values


@pytest.mark.parametrize("samples", [0, 1, 2, 7, 100])
def test_widened(samples):
    gaps = np.random.default_rng(samples).uniform(size=(3, 60)) < 0.05
    expected = [binary_dilation(row, np.ones(2 * samples + 1)) for row in gaps]
    np.testing.assert_array_equal(widened(gaps, samples), expected)


def test_filled():
    values, gaps = filled(np.array([[np.nan, 1.0, np.nan, np.nan, 4.0, np.nan], [0.0] * 6]))
    np.testing.assert_array_equal(values, [[1.0, 1.0, 2.0, 3.0, 4.0, 4.0], [0.0] * 6])
    np.testing.assert_array_equal(gaps, [[True, False, True, True, False, True], [False] * 6])


@pytest.mark.parametrize("corners", [{"low": 0.5}, {"low": 0.5, "high": 20.0}, {"high": 20.0}])
def test_band_pass_remembers_a_gap_for_one_period(corners):
    """Outside, an error below 3 % of the rms; one period of the lowest corner is lost on each side."""
    clean = motion()
    found = signals.band_pass(array(planted(clean)), **corners).values
    exact = signals.band_pass(array(clean), **corners).values
    period = round(1.0 / (min(corners.values()) * STEP))
    gaps = np.isnan(planted(clean))
    np.testing.assert_array_equal(
        np.isnan(found), [binary_dilation(g, np.ones(2 * period + 1)) for g in gaps]
    )
    np.testing.assert_array_equal(found[0], exact[0])
    off = np.nan_to_num(found - exact)
    assert (np.abs(off).max(axis=1) < 0.03 * clean.std(axis=1)).all()
    inside = signals.band_pass(array(filled(planted(clean))[0]), **corners).values - exact
    assert np.abs(inside).max() > 0.5 * clean.std()  # what is lost would have been wrong


def test_decimate_reaches_twenty_samples():
    clean, factor = motion(1), 4
    found = signals.decimate(array(planted(clean)), factor).values
    exact = signals.decimate(array(clean), factor).values
    gaps = [binary_dilation(g, np.ones(160 + 1))[::factor] for g in np.isnan(planted(clean))]
    np.testing.assert_array_equal(np.isnan(found), gaps)
    np.testing.assert_allclose(found[:2][~np.isnan(found[:2])], exact[:2][~np.isnan(found[:2])], atol=1e-9)


@pytest.mark.parametrize("kind", ["constant", "linear"])
def test_detrend_by_what_was_measured(kind):
    time = STEP * np.arange(N)
    values = planted(motion(2) + np.array([[1.0], [-2.0], [3.0]]) + 0.1 * time)
    found = signals.detrend(array(values), kind).values
    for y, x in zip(values, found, strict=True):
        known = ~np.isnan(y)
        line = np.polyfit(time[known], y[known], 1 if kind == "linear" else 0)
        np.testing.assert_allclose(x, y - np.polyval(line, time), atol=1e-9)
    with pytest.raises(ValueError, match="at least 2 samples of every channel, got 0 of channel 2, which"):
        signals.detrend(array(values), kind, window=(28.5, 29.5))


@pytest.mark.parametrize("samples", [3.0, -2.0, 0.4, -1.7])
def test_delay_moves_gaps(samples):
    clean = motion(3)
    delay = {name: samples * STEP for name in ("s0", "s1", "s2")}
    found = signals.correct(array(planted(clean)), delay=delay).values
    exact = signals.correct(array(clean), delay=delay).values
    np.testing.assert_array_equal(found[0], exact[0])
    reach = 0 if samples % 1 == 0 else 10
    first, last = 1400 - round(samples) - reach, 1450 - round(samples) + reach
    assert np.isnan(found[1, first:last]).all() and np.isnan(found[1]).sum() == last - first
    off = np.nan_to_num(found[1] - exact[1])
    assert np.abs(off).max() < (1e-9 if reach == 0 else 0.02) * clean[1].std()


def test_trim_and_scale_leave_gaps():
    values = planted(motion())
    found = signals.trim(signals.correct(array(values), scale=-2.0), 10.0, 20.0).values
    np.testing.assert_array_equal(found, -2.0 * values[:, 1000:2001])


def test_check_of_the_shaking_table_with_gaps(data_dir):
    """Gains and lags as without gaps, to their standard errors, and no word more."""
    channels = signals.detrend(datasets.mini_shake_table("northridge"))
    band, values = (0.5, 1.8), channels.values.copy()
    n = values.shape[1]
    values[2, n // 2 : n // 2 + n // 20] = np.nan
    values[1, ::500] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        clean = signals.check_channels(channels, band)
        found = signals.check_channels(channels.copy(data=values), band)
    for name in ("gain", "lag"):
        off = np.abs(found[name] - clean[name]).values[1:] / found[f"{name}_error"].values[1:]
        assert (off < 3.0).all(), name
    values[3, : int(0.7 * n)] = np.nan  # nothing is left of the motion: nothing is said, and nothing wrong
    found = signals.low_frequency_gains(channels.copy(data=values), band)
    assert np.isnan(found["gain"][3]) and np.isfinite(found["gain"][:3]).all()
    said, usual = (
        [text.split(":")[0] for text in messages(lambda x=x: signals.check_channels(x, band))]
        for x in (channels.copy(data=values), channels)
    )
    assert said == [text for text in usual if "floor3" not in text]
    assert usual[0].startswith("Channel 'floor3' comes")
