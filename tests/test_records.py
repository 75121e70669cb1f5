"""Record: its numbers, its immutability, and every refusal."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest
import xarray as xr

from pymc_features import Loading, Record


@pytest.fixture
def pulse():
    return Record([0.0, 1.5, -3.0, 0.5], dt=0.02, name="pulse")


def test_properties(pulse):
    assert pulse.acceleration.tolist() == [0.0, 1.5, -3.0, 0.5]
    assert (pulse.n_times, len(pulse), pulse.pga, pulse.name) == (4, 4, 3.0, "pulse")
    assert pulse.duration == pytest.approx(0.06, rel=1e-15)
    np.testing.assert_allclose(pulse.time, [0.0, 0.02, 0.04, 0.06], rtol=1e-15)
    assert repr(pulse) == "Record('pulse', 4 samples, dt=0.02 s, duration=0.06 s, pga=3 m/s^2)"
    assert repr(Record([0.0, 1.0], dt=1)).startswith("Record(2 samples")


@pytest.mark.parametrize("values", [[1, -2, 3], np.float32([1, -2, 3])])
def test_any_numbers_become_float64(values):
    record = Record(values, dt=np.float32(0.5), name=7)
    assert record.acceleration.dtype == np.float64
    assert type(record.dt) is float
    assert (record.pga, record.dt, record.name) == (3.0, 0.5, "7")


def test_is_an_immutable_copy_of_what_was_passed(pulse):
    values = np.array([0.0, 1.0, 2.0])
    record = Record(values, dt=0.1)
    values[1] = 99.0
    assert record.acceleration.tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        pulse.acceleration[0] = 1.0
    for name in ("acceleration", "anything"):
        with pytest.raises(dataclasses.FrozenInstanceError, match=f"cannot assign to field '{name}'"):
            setattr(pulse, name, 1.0)
    for again in (copy.deepcopy(pulse), pickle.loads(pickle.dumps(pulse))):
        np.testing.assert_array_equal(again.acceleration, pulse.acceleration)
        assert (again.dt, again.name) == (pulse.dt, pulse.name)


@pytest.mark.parametrize(
    ("acceleration", "error", "match"),
    [
        (["a", "b"], TypeError, "`acceleration` must be an array of numbers, got list of texts. Pass m/s.2"),
        ([[1.0], [1.0, 2.0]], TypeError, "got list. Pass m/s.2, or read files with `read_record`"),
        ([[0.0, 1.0]], ValueError, r"one-dimensional with at least 2 samples, got shape \(1, 2\)"),
        ([1.0], ValueError, r"at least 2 samples, got shape \(1,\). Pass one component"),
        (1.0, ValueError, r"got shape \(\)"),
        ([0.0, 1.0, np.nan, np.inf], ValueError, "must be finite, got nan at index 2. Fill or cut"),
    ],
)
def test_bad_acceleration(acceleration, error, match):
    with pytest.raises(error, match=match):
        Record(acceleration, dt=0.02)


@pytest.mark.parametrize(
    ("dt", "error", "match"),
    [
        (-0.02, ValueError, "`dt` must be positive, got -0.02. Pass the sampling interval in seconds."),
        (np.nan, ValueError, "`dt` must be positive, got nan"),
        (np.inf, ValueError, "`dt` must be positive, got inf"),
        (None, TypeError, "`dt` must be a number, got None. Pass the sampling interval"),
        ([0.0, 0.02], TypeError, "`dt` must be a number"),
    ],
)
def test_bad_dt(dt, error, match):
    with pytest.raises(error, match=match):
        Record([0.0, 1.0], dt=dt)


def measured(**attrs):
    return xr.DataArray(
        [[0.0, 1.0, -3.0], [0.0, 2.0, 4.0]],
        dims=("sensor", "time"),
        coords={"sensor": ["base", "roof"], "time": [5.0, 5.02, 5.04]},
        attrs={"units": "m/s^2"} | attrs,
    )


def test_sampling_rate():
    """In place of the step, of loads and readers; not beside it."""
    for load in (Record([0.0, 1.0], fs=200.0), Loading([[0.0, 1.0]], fs=200.0)):
        assert (load.dt, load.fs, dataclasses.replace(load, name="other").dt) == (0.005, 200.0, 0.005)
    with pytest.raises(TypeError, match="`fs` must be left out where `dt` is given, got 50 Hz and 0.02 s"):
        Record([0.0, 1.0], 0.02, fs=50.0)
    with pytest.raises(ValueError, match="`fs` must be positive"):
        Record([0.0, 1.0], fs=0.0)


def test_record_of_a_channel():
    record = Record.from_channel(measured(), "base")
    assert (record.dt, record.name, record.n_times) == (0.02, "base", 3)
    np.testing.assert_array_equal(record.acceleration, [0.0, 1.0, -3.0])
    assert Record.from_channel(measured().sel(sensor="roof"), name="top").name == "top"
    assert Record.from_channel(measured().isel(sensor=[1])).pga == 4.0
    assert Record.from_channel(measured().isel(sensor=0, drop=True)).name == ""
    numbered = measured().assign_coords(sensor=[7, 8])
    assert Record.from_channel(numbered, 8).pga == 4.0


@pytest.mark.parametrize(
    ("channels", "settings", "error", "match"),
    [
        ([0.0, 1.0], {}, TypeError, "`channels` must be an xarray.DataArray, got list"),
        (measured(), {}, ValueError, "`sensor` must name one channel, got None for an array with dimensions"),
        (
            measured(),
            {"sensor": "ground"},
            ValueError,
            r"one of the channels \['base', 'roof'\], got 'ground'",
        ),
        (measured(units="g"), {"sensor": "base"}, ValueError, '"units"] "m/s.2", got \'g\'. Convert them'),
        (measured()[:, [0, 2, 1]], {"sensor": "base"}, ValueError, "must be evenly sampled"),
        (measured().drop_vars("time"), {"sensor": "base"}, ValueError, "must have a time coordinate"),
    ],
)
def test_channels_that_are_no_record(channels, settings, error, match):
    with pytest.raises(error, match=match):
        Record.from_channel(channels, **settings)
