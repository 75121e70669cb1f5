"""Sign, gain and clock of single sensors."""

import numpy as np
import pytest
import xarray as xr

from pymc_features import signals

STEP, N = 0.01, 800
TIME = STEP * np.arange(N)


def pulse(time):
    """A wave packet below 10 Hz in the middle of the record (time,)."""
    return np.exp(-(((time - 4.0) / 0.8) ** 2)) * np.sin(2.0 * np.pi * 3.0 * time)


def channels(*values):
    names = ["base", "roof", "floor"][: len(values)]
    return xr.DataArray(np.array(values), dims=("sensor", "time"), coords={"sensor": names, "time": TIME})


@pytest.mark.parametrize("late", [0.0, 0.01, 0.0037, -0.0237, 0.5])
def test_shifts_against_the_closed_form(late):
    given = channels(pulse(TIME), pulse(TIME - late))
    found = signals.correct(given, delay={"roof": late})
    np.testing.assert_allclose(found.values[1], pulse(TIME), atol=1e-8)
    np.testing.assert_array_equal(found.values[0], given.values[0])
    np.testing.assert_array_equal(found["time"], given["time"])


def test_offsets_keep_their_value_at_the_ends():
    given = channels(np.full(N, 2.0), 3.0 + pulse(TIME - 0.0337))
    found = signals.correct(given, delay={"roof": 0.0337, "base": -0.0123})
    np.testing.assert_allclose(found.values, [np.full(N, 2.0), 3.0 + pulse(TIME)], atol=1e-8)


def test_factors():
    given = channels(pulse(TIME), -pulse(TIME), pulse(TIME) / 9.80665)
    found = signals.correct(given, scale={"roof": -1.0, "floor": 9.80665})
    np.testing.assert_allclose(found.values, [pulse(TIME)] * 3, rtol=1e-14)
    np.testing.assert_array_equal(signals.correct(given, scale=2.0).values, 2.0 * given.values)
    xr.testing.assert_identical(signals.correct(given).drop_attrs(), given)


@pytest.mark.parametrize(
    ("settings", "error", "match"),
    [
        ({"scale": {"attic": 1.0}}, ValueError, "`scale` must name sensors among base, roof, got 'attic'"),
        ({"scale": {"roof": 0.0}}, ValueError, "`scale` must not be zero, got 0 for 'roof'"),
        ({"scale": {"roof": np.nan}}, TypeError, "`scale` must be a mapping of sensors to finite numbers"),
        ({"delay": 0.1}, TypeError, "`delay` must be a mapping of sensors to finite numbers, got 0.1"),
        ({"delay": {"roof": 3.0}}, ValueError, "`delay` must be at most a quarter .* 2 s, got 3 s"),
    ],
)
def test_refusals(settings, error, match):
    with pytest.raises(error, match=match):
        signals.correct(channels(pulse(TIME), pulse(TIME)), **settings)
