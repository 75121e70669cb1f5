"""Records at another rate, with a delay; what a copy keeps; interpolation that there is not."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

import pymc_features as pmf
from pymc_features import band_limited


def smooth(time):
    """A motion without content above 8 Hz."""
    rng = np.random.default_rng(3)
    f, phase = rng.uniform(0.3, 8.0, 12), rng.uniform(0.0, 6.0, 12)
    return np.sin(2.0 * np.pi * f * time[:, None] + phase).sum(axis=1)


@pytest.mark.parametrize(("dt", "delay"), [(0.005, 0.123), (0.02, -0.505), (0.01, 1.0)])
def test_any_rate_and_delay(dt, delay):
    """Against the motion itself, away from the ends; straight lines are off ten times as much."""
    record = pmf.Record(smooth(np.arange(2000) * 0.01), 0.01)
    found = record.resampled(dt, delay=delay)
    first = np.ceil(max(delay, 0.0) / dt - 1e-6) * dt
    expected = smooth(first + found.time - delay)
    inside = slice(round(1.0 / dt), -round(1.0 / dt))
    error = abs(found.acceleration - expected)[inside].max() / abs(expected).max()
    assert error < 1e-4
    if dt != 0.01:
        lines = replace(record, interpolation="linear").resampled(dt, delay=delay)
        assert abs(lines.acceleration - expected)[inside].max() > 10.0 * error * abs(expected).max()
    assert found.dt == dt
    assert abs(first + found.duration - delay - record.duration) < dt + 1e-9 or delay < 0.0


@pytest.mark.parametrize("interpolation", ["band-limited", "linear"])
def test_the_interpolation_travels_with_copies(interpolation):
    record = pmf.Record([0.0, 1.0, 0.0, 2.0], 0.01, "r", interpolation=interpolation)
    loading = pmf.Loading([[0.0, 1.0, 0.0, 2.0]], 0.01, interpolation=interpolation)
    for load in (record, loading):
        copies = copy.deepcopy(load), pickle.loads(pickle.dumps(load)), load.first(3), replace(load, dt=1.0)
        for other in copies:
            assert other.interpolation == interpolation
            assert not other.inputs.flags.writeable
    assert pmf.datasets.el_centro().interpolation == "linear"
    assert pmf.synthetic_earthquake(5.0, 0.02, random_seed=1).interpolation == "band-limited"


def test_what_is_refused():
    with pytest.raises(ValueError, match=r"`delay` must leave two samples of 0.02 s"):
        pmf.Record([0.0, 1.0, 0.0], 0.01).resampled(0.01, delay=-0.02)
    for build in (pmf.Record, pmf.Loading):
        with pytest.raises(ValueError, match="`interpolation` must be one of band-limited, linear"):
            build([0.0, 1.0], 0.01, interpolation="cubic")


def test_the_ends_of_a_history_that_was_resampled_before():
    """An anti-aliasing filter leaves nothing above its corner: predictions of least squares explode there."""
    rng = np.random.default_rng(5)
    corner = signal.butter(4, [0.3, 12.0], "bandpass", fs=200.0, output="sos")
    whole = signal.sosfiltfilt(corner, rng.normal(size=4096))
    coarse, time = signal.resample_poly(whole, 25, 32), 0.005 * np.arange(4096)
    inside = (time > 1.0) & (time < 17.0)
    for last in (2500, 2700, 2900, 3100):
        found = band_limited.at_times(coarse[None, :last], 0.0064, time[time < 0.0064 * (last - 1)], 0.005)[0]
        off = np.abs(found - whole[: found.size])[
            inside[: found.size] & (time[: found.size] < 0.0064 * last - 1.0)
        ]
        assert off.max() < 2e-3 * np.abs(whole).max()
