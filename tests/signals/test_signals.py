"""Processing and checks of measured channels, on responses that are known."""

import re

import numpy as np
import pytest
import xarray as xr
from scipy import signal as scipy_signal

from pymc_features import RayleighDamping, SpringMassChain, signals, simulate, synthetic_earthquake
from pymc_features.signals import check_channels
from pymc_features.signals.check import check_each
from support.warned import messages

STEP = 0.01
BAND = (0.6, 1.6)  # the chain below has its first natural frequency at 3.6 Hz
CHAIN = SpringMassChain([0.16, 0.16, 0.142], [380.0, 450.0, 600.0], RayleighDamping(0.2, 2e-4))


def array(values, step=STEP, start=0.0):
    values = np.asarray(values, dtype=float)
    names = ["base", "floor1", "floor2", "floor3"][: len(values)] if values.ndim == 2 else []
    coords = {"time": start + step * np.arange(values.shape[-1])} | ({"sensor": names} if names else {})
    dims = ("sensor", "time") if names else ("time",)
    return xr.DataArray(values, dims=dims, coords=coords, attrs={"units": "m/s^2"}, name="acceleration")


@pytest.fixture(scope="module")
def building():
    """Base and floors (4, time) of a shaken chain, with noise and offsets."""
    record = synthetic_earthquake(60.0, STEP, random_seed=5, pga=3.0)
    floors = simulate(CHAIN, record).values
    rng = np.random.default_rng(6)
    values = np.vstack([record.acceleration, floors])
    return values + 0.01 * rng.standard_normal(values.shape) + np.array([[0.1], [0.2], [0.05], [-0.05]])


def delayed(history, lag):
    """A history [time] that comes `lag` seconds later, by its Fourier series."""
    frequencies = np.fft.rfftfreq(history.size, STEP)
    return np.fft.irfft(np.fft.rfft(history) * np.exp(-2j * np.pi * frequencies * lag), history.size)


# --- trim, detrend ------------------------------------------------------------------------------


@pytest.mark.parametrize("origin", [0.0, 991.02])
def test_trim_keeps_both_ends_and_says_where_it_started(origin):
    channels = array(np.arange(40.0).reshape(2, 20), start=origin)
    channels.attrs["start"] = 7.0
    cut = signals.trim(channels, origin + 0.03, origin + 0.08)
    np.testing.assert_array_equal(cut.values, channels.values[:, 3:9])
    np.testing.assert_allclose(cut["time"], 0.01 * np.arange(6), atol=1e-15)
    assert cut.attrs["start"] == pytest.approx(7.03, abs=1e-12)
    assert (cut.attrs["units"], cut.name, list(cut["sensor"].values)) == (
        "m/s^2",
        "acceleration",
        ["base", "floor1"],
    )
    again = signals.trim(cut, 0.011, 0.04)  # between samples: only what lies inside
    np.testing.assert_array_equal(again.values, channels.values[:, 5:8])
    assert again.attrs["start"] == pytest.approx(7.05, abs=1e-12)


def test_trim_copies():
    channels = array(np.arange(10.0))
    signals.trim(channels, 0.0, 0.05)[0] = 99.0
    assert channels[0] == 0.0


@pytest.mark.parametrize("kind", ["constant", "linear"])
@pytest.mark.parametrize("shape", [(300,), (3, 300), (2, 301)])
def test_detrend_is_that_of_scipy(kind, shape):
    rng = np.random.default_rng(1)
    values = rng.standard_normal(shape) + 5.0 + 0.02 * np.arange(shape[-1])
    found = signals.detrend(array(values), kind)
    np.testing.assert_allclose(found.values, scipy_signal.detrend(values, type=kind), atol=1e-11)


def test_detrend_by_a_quiet_window():
    time = STEP * np.arange(500)
    pulse = np.where(time > 2.0, 3.0, 0.0)
    drift = np.array([[0.2], [-0.1]]) + np.array([[0.03], [0.0]]) * time
    still = signals.detrend(array(drift + pulse), "linear", window=(0.0, 1.5))
    np.testing.assert_allclose(still.values, np.broadcast_to(pulse, (2, 500)), atol=1e-12)
    offset = signals.detrend(array(0.7 + pulse), window=(0.0, 1.5))
    np.testing.assert_allclose(offset.values, pulse, atol=1e-12)


# --- filters ------------------------------------------------------------------------------------


def amplitude(history, frequency):
    """Complex amplitude of a sine (time,), from the middle of a history whose ends are left out."""
    middle = np.asarray(history)[1000:-1000]
    time = STEP * (1000 + np.arange(middle.size))
    basis = np.column_stack([np.cos(2 * np.pi * frequency * time), np.sin(2 * np.pi * frequency * time)])
    cosine, sine = np.linalg.lstsq(basis, middle)[0]
    return cosine - 1j * sine


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("frequency", [0.3, 1.0, 3.0, 10.0, 25.0])
def test_band_pass_has_the_stated_gain_and_no_phase(order, frequency):
    wave = array(np.cos(2 * np.pi * frequency * STEP * np.arange(8000)))

    def warped(f):  # the bilinear transform maps frequencies so
        return np.tan(np.pi * f * STEP)

    low = 1.0 / (1.0 + (warped(frequency) / warped(8.0)) ** (2 * order))
    high = 1.0 / (1.0 + (warped(1.0) / warped(frequency)) ** (2 * order))
    for settings, gain in [({"high": 8.0}, low), ({"low": 1.0}, high)]:
        found = amplitude(signals.band_pass(wave, **settings, order=order), frequency)
        assert found == pytest.approx(gain, abs=2e-3)
    both = amplitude(signals.band_pass(wave, 1.0, 8.0, order=order), frequency)
    assert abs(both.imag) < 2e-3
    assert both.real == pytest.approx(low * high, abs=0.06)  # corners of a band-pass interact a little


def test_band_pass_removes_offsets_and_keeps_channels_apart():
    wave = np.sin(2 * np.pi * 3.0 * STEP * np.arange(4000))
    found = signals.band_pass(array([wave + 5.0, -2.0 * wave]), 0.5, 20.0)
    np.testing.assert_allclose(found.values[1, 500:-500], -2.0 * found.values[0, 500:-500], atol=1e-4)
    assert abs(found.values[0, 500:-500].mean()) < 1e-4


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_decimate_passes_below_and_stops_above(factor):
    limit = 0.5 / (factor * STEP)  # half of the new sampling rate
    time = STEP * np.arange(12000)
    for share, expected in [(0.02, 1.0), (0.3, 1.0), (0.75, 1.0), (1.0, 0.0), (1.3, 0.0), (1.9, 0.0)]:
        if share * limit >= 0.5 / STEP:
            continue
        wave = np.cos(2 * np.pi * share * limit * time + 0.3)
        slow = signals.decimate(array(wave), factor)
        assert slow.sizes["time"] == np.ceil(12000 / factor)
        assert signals.sampling_step(slow) == pytest.approx(factor * STEP, rel=1e-12)
        inner = slice(50, -50)
        np.testing.assert_allclose(slow.values[inner], expected * wave[::factor][inner], atol=1e-3)


def test_decimate_keeps_offsets_and_drifts_to_the_ends():
    line = 3.0 + 0.5 * STEP * np.arange(900)
    np.testing.assert_allclose(signals.decimate(array([line, -line]), 4).values[0], line[::4], atol=1e-12)
    assert signals.decimate(array(line), 1).values.tolist() == line.tolist()


# --- what is refused ----------------------------------------------------------------------------

LINE = array(np.arange(30.0))


@pytest.mark.parametrize(
    ("action", "error", "match"),
    [
        (lambda: signals.trim(np.zeros(5), 0, 1), TypeError, "`channels` must be an xarray.DataArray"),
        (lambda: signals.trim(LINE.rename(time="t"), 0, 1), ValueError, "must have dimensions .*Transpose"),
        (lambda: check_channels(LINE, (1, 2)), ValueError, r"must have dimensions \('sensor', 'time'\), got"),
        (lambda: signals.detrend(LINE * np.nan), ValueError, "samples of every sensor, got NaN alone in '0'"),
        (lambda: signals.detrend(LINE / 0.0), ValueError, "must be finite, got inf at index 1"),
        (lambda: signals.detrend(LINE.astype(str)), TypeError, "`channels` must hold numbers"),
        (lambda: signals.detrend(LINE.drop_vars("time")), ValueError, "must have a time coordinate"),
        (lambda: signals.detrend(LINE[[0, 1, 2, 5]]), ValueError, "evenly sampled.*0.01 s to 0.03 s"),
        (lambda: signals.detrend(LINE[::-1]), ValueError, "must be evenly sampled"),
        (lambda: signals.trim(LINE, 0.1, 0.5), ValueError, r"within the record, 0 s to 0.29 s.*\(0.1, 0.5\)"),
        (lambda: signals.trim(LINE, -0.1, 0.2), ValueError, "must lie within the record"),
        (lambda: signals.trim(LINE, 0.2, 0.1), ValueError, "run forward"),
        (lambda: signals.trim(LINE, np.nan, 0.1), ValueError, "must lie within the record"),
        (lambda: signals.trim(LINE, "a", 0.1), TypeError, "must be two times"),
        (lambda: signals.trim(LINE, 0.101, 0.109), ValueError, "at least 2 samples"),
        (lambda: signals.detrend(LINE, "cubic"), ValueError, "`kind` must be one of constant, linear"),
        (lambda: signals.detrend(LINE, window=(0.1, 9.0)), ValueError, "`window` must lie within"),
        (lambda: signals.detrend(LINE, window=3.0), TypeError, "`window` must be two times"),
        (lambda: signals.band_pass(LINE), ValueError, "`low` or `high` must be given"),
        (lambda: signals.band_pass(LINE, 5.0, 1.0), ValueError, "`low` must be below `high`, got 5 and"),
        (lambda: signals.band_pass(LINE, high=50.0), ValueError, "`high` must lie between 0 and 50 Hz"),
        (lambda: signals.band_pass(LINE, low=0.0), ValueError, "`low` must lie between"),
        (lambda: signals.band_pass(LINE, low="1"), TypeError, "`low` must be a number, .* in Hz"),
        (lambda: signals.band_pass(LINE, 1.0, order=0), ValueError, "`order` must be an integer from 1 to"),
        (lambda: signals.band_pass(LINE, 1.0, order=2.5), ValueError, "`order` must be an integer"),
        (lambda: signals.band_pass(LINE, 1.0, order=11), ValueError, "`order` must be an integer from 1 to"),
        (lambda: signals.band_pass(LINE, 1e-9), ValueError, "`low` must not be so far below the sampling"),
        (lambda: signals.band_pass(LINE, 1.0, 5.0, order=8), ValueError, "more than 51 samples.*Lower"),
        (lambda: signals.decimate(LINE, 2), ValueError, "at least 81 samples to be decimated by 2, got 30"),
        (lambda: signals.decimate(LINE, 0), ValueError, "`factor` must be an integer of at least 1, got 0"),
        (lambda: signals.decimate(LINE, 1.5), ValueError, "`factor` must be an integer"),
    ],
)
def test_refused(action, error, match):
    with pytest.raises(error, match=match):
        action()


# --- gains and lags -----------------------------------------------------------------------------


def transfer(frequency):
    """Absolute acceleration of the floors per unit of base motion, by dense algebra."""
    mass, damping, stiffness = CHAIN.matrices()
    omega = 2 * np.pi * frequency
    dynamic = stiffness + 1j * omega * damping - omega**2 * mass
    return 1.0 + omega**2 * np.linalg.solve(dynamic, mass @ np.ones(3))


def test_gains_are_those_of_the_transfer_function(building):
    found = signals.low_frequency_gains(array(building), BAND)
    frequencies, power = scipy_signal.periodogram(building[0], 1.0 / STEP)
    inside = (frequencies >= BAND[0]) & (frequencies <= BAND[1])
    exact = np.array([transfer(f) for f in frequencies[inside]])
    gain = (exact.real * power[inside, None]).sum(axis=0) / power[inside].sum()
    np.testing.assert_allclose(found["gain"].values[1:], gain, rtol=0.01)
    assert found["gain"].values[0] == pytest.approx(1.0, rel=1e-12)
    assert (found["coherence"] > 0.99).all()
    assert (np.abs(found["lag"]) < 5e-4).all()
    assert found["lag"].attrs == {"units": "s"}


@pytest.mark.parametrize("lag", [-0.73, -0.05, -0.0021, 0.0021, 0.013, 0.2, 3.0])
@pytest.mark.parametrize("scale", [1.0, -9.81])
def test_lags_are_found(building, lag, scale):
    values = building.copy()
    values[2] = scale * delayed(values[2], lag)
    clean = signals.low_frequency_gains(array(building), BAND)
    found = signals.low_frequency_gains(array(values), BAND)
    assert float(found["lag"][2] - clean["lag"][2]) == pytest.approx(lag, abs=4e-4)
    assert float(found["gain"][2] / clean["gain"][2]) == pytest.approx(scale, rel=0.01)
    np.testing.assert_allclose(found["lag"][[0, 1, 3]], clean["lag"][[0, 1, 3]])


def test_standard_errors_are_those_of_repetitions(building):
    rng = np.random.default_rng(8)
    base = building[0]
    pairs = [np.array([base, 1.2 * base + 0.3 * rng.standard_normal(base.size)]) for _ in range(60)]
    found = [signals.low_frequency_gains(array(pair), BAND).isel(sensor=1) for pair in pairs]
    for name, truth in [("gain", 1.2), ("lag", 0.0)]:
        values = np.array([float(each[name]) for each in found])
        error = np.mean([float(each[f"{name}_error"]) for each in found])
        assert 0.6 < values.std() / error < 1.4
        assert abs(values.mean() - truth) < 0.5 * error


# --- checks of channels against each other ------------------------------------------------------


def test_a_sound_building_passes(building):
    assert messages(lambda: check_channels(array(building), BAND)) == []
    found = check_channels(array(building), BAND)
    peaks = np.abs(building - np.median(building, axis=1, keepdims=True)).max(axis=1)
    np.testing.assert_array_equal(found["peak"], peaks)
    np.testing.assert_array_equal(found["sensor"], ["base", "floor1", "floor2", "floor3"])
    assert (np.diff(found["gain"]) > 0.0).all()


def test_no_false_alarms():
    """Sound buildings of other stiffness under other motions, over 20 s only."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        stiffness = np.array([380.0, 450.0, 600.0]) * rng.uniform(0.7, 1.4, 3)
        record = synthetic_earthquake(20.0, STEP, random_seed=seed, pga=3.0)
        floors = simulate(SpringMassChain([0.16, 0.16, 0.142], stiffness, RayleighDamping(0.5, 1e-3)), record)
        values = np.vstack([record.acceleration, floors.values])
        values += 0.01 * rng.standard_normal(values.shape)
        assert messages(lambda values=values: check_channels(array(values), BAND)) == []


def broken(values, defect):
    values = values.copy()
    if defect == "inverted":
        values[2] *= -1.0
    elif defect == "base inverted":
        values[0] *= -1.0
    elif defect == "swapped":
        values[[1, 3]] = values[[3, 1]]
    elif defect == "base swapped":
        values[[0, 2]] = values[[2, 0]]
    elif defect == "in g":
        values[3] /= 9.81
    elif defect == "in cm/s^2":
        values[1] *= 0.01
    elif defect == "sensitivity":
        values[1] *= 3.0
    elif defect == "late":
        values[3] = delayed(values[3], 0.0025)
    elif defect == "early":
        values[1] = delayed(values[1], -0.04)
    elif defect == "unrelated":
        values[2] = np.random.default_rng(3).standard_normal(values.shape[1])
    elif defect == "clipped":
        values[3] = values[3].clip(-np.inf, 0.85 * values[3].max())
    elif defect == "copied":
        values[2] = values[1]
    return values


DEFECTS = {
    "inverted": ["Channel 'floor2' is inverted against 'base': low-frequency gain -1.1"],
    "base inverted": [f"Channel 'floor{k}' is inverted against 'base'" for k in (1, 2, 3)],
    "swapped": ["Sensors may be swapped.*gains must rise, got base 1.000, floor1 1.1.*floor3 1.0"],
    "base swapped": ["Sensors may be swapped"],
    "in g": [
        "'floor3' has a low-frequency gain of 0.1.*as if one were in g and the other in m/s.2. Check units"
    ],
    "in cm/s^2": ["'floor1' has a low-frequency gain of 0.01.*as if one were in cm/s.2. Check units"],
    "sensitivity": [
        "'floor1' has a low-frequency gain of 3.* against 'base', where floors follow the base. Check"
    ],
    "late": [r"'floor3' comes 2\.\d+ ms \(0.2\d+ samples\) after 'base', \+- 0.\d+ ms"],
    "early": [r"'floor1' comes (40|39.\d) ms \((4|3.9\d) samples\) before 'base'"],
    "unrelated": ["'floor2' is unrelated to 'base': coherence 0.0"],
    "clipped": [r"'floor3' looks clipped: \d+ samples at its largest value .* m/s.2, in \d+ flat tops"],
    "copied": ["Channels 'floor1' and 'floor2' are identical to the last bit"],
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_defects_are_told_and_only_they(building, defect):
    found = messages(lambda: check_channels(array(broken(building, defect)), BAND))
    assert len(found) == len(DEFECTS[defect]), found
    for message, pattern in zip(found, DEFECTS[defect], strict=True):
        assert re.search(pattern, message), message


def test_base_may_be_any_sensor(building):
    channels = array(building[[1, 2, 3, 0]]).assign_coords(sensor=["one", "two", "three", "table"])
    found = signals.low_frequency_gains(channels, BAND, base="table")
    np.testing.assert_allclose(
        found["gain"][[3, 0, 1, 2]], signals.low_frequency_gains(array(building), BAND)["gain"], rtol=1e-12
    )


def test_where_one_clock_is_late_all_are_put_right(building):
    """By what chance and damping do not explain, if no message is worth it; else the corrected data of a late
    sensor would not be those of the same sensor in time.
    """
    values = building.copy()
    values[1] = delayed(values[1], 0.00095)  # below a tenth of a sample
    assert messages(lambda: check_channels(array(values), BAND)) == []
    assert (check_channels(array(values), BAND)["delay"] == 0.0).all()
    with_late = values.copy()
    with_late[3] = delayed(values[3], 0.0123)
    with pytest.warns(match="'floor3' comes 12.* ms .* after 'base'") as told:
        found = check_channels(array(with_late), BAND)
    assert len(told) == 1
    np.testing.assert_allclose(found["delay"], [0.0, 0.00095, 0.0, 0.0123], atol=4e-4)
    assert (found["delay"][[0, 2]] == 0.0).all()
    assert (found["delay"][[1, 3]] == found["lag"][[1, 3]]).all()


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_numbers_as_large_as_they_get_and_few_of_them(building):
    values = building.copy()
    values[1, 500:502] = 1e308, -1e308
    told = messages(lambda: check_each(array(values)))
    assert len(told) == 1
    assert "'floor1' has an implausible peak of 1e+308 m/s^2" in told[0]
    assert messages(lambda: check_each(array(building[:, :2]))) == []


def test_lag_that_damping_explains_is_not_told(building):
    """A slow, damped chain: its floors lag by more than a tenth of a sample."""
    chain = SpringMassChain([1.0, 1.0, 1.0], [90.0, 90.0, 90.0], RayleighDamping(0.5, 0.02))
    record = synthetic_earthquake(300.0, STEP, random_seed=5, pga=3.0)
    channels = array(np.vstack([record.acceleration, simulate(chain, record).values]))
    assert messages(lambda: check_channels(channels, (0.15, 0.33), damping_ratio=0.1)) == []
    late = messages(lambda: check_channels(channels, (0.15, 0.33), damping_ratio=1e-4))
    assert late
    assert all("after 'base'" in message for message in late)


@pytest.mark.parametrize(
    ("settings", "error", "match"),
    [
        ({"band": 1.0}, TypeError, "`band` must be two frequencies"),
        ({"band": (2.0, 1.0)}, ValueError, "`band` must rise"),
        ({"band": (0.5, 80.0)}, ValueError, "`band` must lie between 0 and 50 Hz"),
        ({"band": (0.01, 0.02)}, ValueError, "must last at least 1.2e.03 s for the band.*got 60"),
        ({"band": BAND, "base": "roof"}, ValueError, "one of the sensors 'base', 'floor1'.*'roof'"),
        ({"band": BAND, "damping_ratio": 0.0}, ValueError, "`damping_ratio` must lie between 0 and 1"),
        ({"band": BAND, "damping_ratio": 2.0}, ValueError, "0.02 is 2 %"),
    ],
)
def test_check_refuses(building, settings, error, match):
    with pytest.raises(error, match=match):
        check_channels(array(building), **settings)


def test_constant_channel_is_refused(building):
    values = building.copy()
    values[2] = 0.3
    with pytest.raises(ValueError, match="Channel 'floor2' must move, all its 6001 samples are 0.3. Leave"):
        check_channels(array(values), BAND)
