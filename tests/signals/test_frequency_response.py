"""Frequency response functions of simulated tests, whose truth is closed-form and shares nothing."""

import warnings

import numpy as np
import pytest
import xarray as xr
from scipy.signal import coherence, csd, freqz, lfilter, welch

from pymc_features.exceptions import ChannelWarning
from pymc_features.signals import frequency_response

# --- blows on a structure of three modes, in closed form --------------------------------------------

FS, BLOWS = 2048.0, 5
OMEGA, ZETA = 2.0 * np.pi * np.array([40.0, 95.0, 180.0]), np.array([0.03, 0.02, 0.015])
POLES = -ZETA * OMEGA + 1j * OMEGA * np.sqrt(1.0 - ZETA**2)
AT_REFERENCES = np.array([[1.0, 0.7, -0.4], [0.3, -1.0, 0.8]])  # (reference, mode)
AT_RESPONSES = np.array([[1.0, 0.7, -0.4], [-0.6, 0.5, 1.1], [0.2, 0.9, 0.6]])  # (response, mode)
TAU = 4e-3  # s, of a pulse (1 - cos)^2 / 4


def accelerance(f, sigma=0.0):
    """(response, reference, line) at sigma + 2 pi i f."""
    s = sigma + 2j * np.pi * f
    modes = s**2 / (s**2 + 2.0 * (ZETA * OMEGA)[:, None] * s + OMEGA[:, None] ** 2)
    return np.einsum("pm,rm,ml->prl", AT_RESPONSES, AT_REFERENCES, modes)


def from_rest(t):
    """Accelerations (mode, time) under (1 - cos(2 pi t / tau))^2 / 4 from t = 0 on, which does not end."""
    after, found = np.maximum(t, 0.0), 0.0
    for k, c in enumerate((3 / 8, -1 / 4, -1 / 4, 1 / 16, 1 / 16)):
        s = 2j * np.pi / TAU * (0, 1, -1, 2, -2)[k]
        # exp(s t) / ((s - p)(s - p*)) and what cancels its displacement and velocity at t = 0
        for pole, other in ((POLES, POLES.conj()), (POLES.conj(), POLES)):
            found = found + c * (pole**2 / ((pole - s) * (pole - other)))[:, None] * np.exp(
                np.outer(pole, after)
            )
        found = found + c * (s**2 / ((s - POLES) * (s - POLES.conj())))[:, None] * np.exp(s * after)
    return np.where(t >= 0.0, found.real, 0.0)


def hammer_test(rng, duration=2.0, noise=0.01, levels=(1.0,) * BLOWS):
    """Forces (reference, blow, time), responses without noise, noise (reference, blow, response, time)."""
    t = np.arange(round(duration * FS)) / FS
    forces = np.zeros((len(AT_REFERENCES), BLOWS, t.size))
    motions = np.zeros((len(AT_REFERENCES), BLOWS, len(AT_RESPONSES), t.size))
    for r, n in np.ndindex(forces.shape[:2]):
        late = t - 0.01 - rng.uniform(0.0, 1.0 / FS)
        pulse = 0.25 * (1.0 - np.cos(2.0 * np.pi * late / TAU)) ** 2
        size = rng.uniform(0.5, 1.5)
        forces[r, n] = size * np.where((late >= 0.0) & (late < TAU), pulse, 0.0)
        modes = from_rest(late) - from_rest(late - TAU)
        motions[r, n] = size * (AT_RESPONSES * AT_REFERENCES[r]) @ modes
    scale = noise * motions.std(axis=(0, 1, 3))[:, None] * np.array(levels)[:, None, None]
    return forces, motions, scale * rng.standard_normal(motions.shape)


def padded(values, times):
    return np.concatenate([values, np.zeros((*values.shape[:-1], (times - 1) * values.shape[-1]))], axis=-1)


BAND = (10.0, 400.0)


def errors(tests, *, pad=1, decay=0.0, seed=0, **test):
    """|error|^2 / E|error|^2 (test, response, reference, line), and z-scores of a gain of all lines."""
    rng, ratios, scores = np.random.default_rng(seed), [], []
    for _ in range(tests):
        force, motion, noise = hammer_test(rng, **test)
        frf = frequency_response(
            padded(force, pad), padded(motion + noise, pad), fs=FS, band=BAND, decay=decay
        )
        truth, v = accelerance(frf["frequency"].values, decay), frf["variance"].values
        error = frf["frequency_response"].values - truth
        ratios.append(np.abs(error) ** 2 / (v / frf["variance"].attrs["factor"]))
        weights = (np.abs(truth) ** 2 / v).sum(-1)
        scores.append((error * truth.conj() / v).real.sum(-1) / np.sqrt(weights / 2.0))
    return np.array(ratios), np.array(scores), frf


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("settings", "factor", "widths"),
    [
        ({}, 1.0, (0.8, 1.2)),
        ({"pad": 2}, 2.0, (0.8, 1.2)),
        ({"decay": 1.5}, 6.0 / (1.0 - np.exp(-6.0)), (0.45, 1.05)),
        ({"levels": (1.0, 1.0, 6.0, 1.0, 2.0)}, 1.0, (0.8, 1.2)),
    ],
    ids=str,
)
def test_variance_of_blows(settings, factor, widths):
    """Mean 1 of |error|^2 over its expectation, 90 % below ln 10; a gain of all lines is as wide as said."""
    ratios, scores, frf = errors(16, **settings)
    assert frf["variance"].attrs["factor"] == pytest.approx(factor, rel=1e-3)
    assert ratios.mean() == pytest.approx(1.0, abs=0.05)
    assert (ratios < np.log(10.0)).mean() == pytest.approx(0.9, abs=0.015)
    assert widths[0] < scores.std() < widths[1]


@pytest.mark.statistical
def test_a_variance_of_each_line_alone_covers_less():
    """The negative control: by raw coherence it is F distributed, 1 - (1 + ln(10) / 4)^-4 = 84 % for 90 %."""
    rng = np.random.default_rng(1)
    covered = []
    for _ in range(10):
        force, motion, noise = hammer_test(rng)
        frf = frequency_response(force, motion + noise, fs=FS, band=BAND)
        g, H = frf["coherence"].values, frf["frequency_response"].values
        raw = np.abs(H) ** 2 * (1.0 - g) / (g * (BLOWS - 1))
        covered.append(np.abs(H - accelerance(frf["frequency"].values)) ** 2 < np.log(10.0) * raw)
    assert np.mean(covered) == pytest.approx(0.838, abs=0.02)


@pytest.mark.statistical
def test_noisy_blows_count_less():
    """With one blow of tenfold noise the error is that of the four others: 5/4 of five equal ones, not 20."""
    equal, _, _ = errors(4, seed=3)
    force, motion, noise = hammer_test(np.random.default_rng(4), levels=(1.0, 1.0, 10.0, 1.0, 1.0))
    frf = frequency_response(force, motion + noise, fs=FS, band=BAND)
    four = frequency_response(force, motion + noise, fs=FS, band=BAND, leave_out=[("0", 2), ("1", 2)])
    for found in (frf, four):
        error = np.abs(found["frequency_response"].values - accelerance(found["frequency"].values)) ** 2
        found["error"] = error.mean()
    assert frf["error"] < 1.05 * four["error"]
    assert equal.mean() == pytest.approx(1.0, abs=0.05)


def test_what_is_kept_of_a_hammer_test():
    force, motion, noise = hammer_test(np.random.default_rng(0))
    frf = frequency_response(force, motion + noise, dt=1.0 / FS, decay=1.5)
    assert frf["frequency_response"].dims == frf["variance"].dims == frf["coherence"].dims
    assert frf["frequency_response"].dims == ("response", "reference", "frequency")
    assert frf["frequency_response"].dtype == np.complex128 and frf["frequency"][0] == 0.5
    assert frf["response"].values.tolist() == ["0", "1", "2"] and frf["reference"].values.tolist() == [
        "0",
        "1",
    ]
    blow = frf.attrs.pop("blow")
    assert blow == pytest.approx(0.01 + 0.5 * TAU + 0.5 / FS, abs=0.2 / FS)
    assert frf.attrs == {
        "quantity": "accelerance",
        "excitation": "force",
        "units": "(m/s^2)/N",
        "n_averages": BLOWS,
        "duration": 2.0,
        "dt": 1.0 / FS,
        "decay": 1.5,
    }
    long = frequency_response(padded(force, 2), padded(motion + noise, 2), fs=FS)
    assert long.attrs["duration"] == 2.0 and long["frequency"][0] == 0.25


def test_one_blow_has_no_variance():
    force, motion, _ = hammer_test(np.random.default_rng(0))
    frf = frequency_response(force[:, :1], motion[:, :1], fs=FS, band=BAND)
    assert list(frf) == ["frequency_response"] and frf.attrs["n_averages"] == 1
    truth = accelerance(frf["frequency"].values)
    np.testing.assert_allclose(frf["frequency_response"], truth, atol=1e-4 * np.abs(truth).max())


# --- blows that are doubtful ------------------------------------------------------------------------


def spoilt():
    """Blows of which one hits twice and one is overloaded."""
    force, motion, noise = hammer_test(np.random.default_rng(0))
    force[0, 1, 100:115] += 0.4 * force[0, 1].max() * np.hanning(15)
    motion = motion + noise
    top = 0.6 * np.abs(motion[1, 3, 0]).max()
    motion[1, 3, 0] = np.clip(motion[1, 3, 0], -top, top)
    names = {"reference": ["1:+z", "2:+z"]}
    x = xr.DataArray(force, names, ("reference", "blow", "time"), attrs={"units": "N"})
    dims = ("reference", "blow", "response", "time")
    return x, xr.DataArray(motion, names | {"response": ["a", "b", "c"]}, dims, attrs={"units": "m/s^2"})


def test_double_hits_and_overloads_are_named():
    x, y = spoilt()
    with pytest.warns(ChannelWarning) as told:
        frequency_response(x, y, fs=FS)
    assert len(told) == 1
    text = str(told[0].message)
    assert (
        "blow 1 of '1:+z' has 2 hits" in text and "blow 3 of '2:+z' has 1 of its channels overloaded" in text
    )
    assert text.count("blow") == 2 and 'leave_out="doubtful"' in text


@pytest.mark.parametrize("leave_out", ["doubtful", [("1:+z", 1), ("2:+z", 3)]])
def test_doubtful_blows_are_left_out(leave_out):
    x, y = spoilt()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        frf = frequency_response(x, y, fs=FS, band=BAND, leave_out=leave_out)
    assert frf.attrs["n_averages"] == BLOWS - 1
    gaps = x.where(x.blow != 1), y.where(y.blow != 3)  # and so are blows of NaN
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        other = frequency_response(*gaps, fs=FS, band=BAND)
    assert other.attrs["n_averages"] == BLOWS - 2
    truth = accelerance(frf["frequency"].values)
    ratio = np.abs(frf["frequency_response"] - truth) ** 2 / frf["variance"]
    assert ratio.mean() == pytest.approx(1.0, abs=0.2)


def test_sound_blows_are_not_doubtful():
    """Among them forces of coarse resolution, and long flat tops of low frequencies."""
    force, motion, noise = hammer_test(np.random.default_rng(0))
    slow = np.round(500.0 * np.sin(np.arange(force.shape[-1]) / 200.0)) + 0.0 * motion
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        frequency_response(np.round(force, 2), np.round(motion + noise, 3), fs=FS)
        frequency_response(force, slow, fs=FS)


# --- shakers and the motion of a base, by filters ---------------------------------------------------

RATE, ZETA_1 = 200.0, 0.05


def filters(f):
    """Numerator and denominator of a mode at f Hz, at 200 Hz."""
    pole = np.exp(2.0 * np.pi * f / RATE * (-ZETA_1 + 1j * np.sqrt(1.0 - ZETA_1**2)))
    return [1.0, -1.0], np.poly([pole, pole.conj()]).real


def gains(f, at):
    return freqz(*filters(f), worN=2.0 * np.pi * at / RATE)[1]


def shaken(rng, n=40_000, noise=0.3, modes=((20.0, 50.0), (30.0, 20.0))):
    """Two correlated excitations (reference, time) and responses (response, time), with the noise apart."""
    x = rng.standard_normal((2, n))
    x[1] += 0.5 * x[0]
    y = np.array([sum(lfilter(*filters(f), one) for f, one in zip(row, x, strict=True)) for row in modes])
    return x, y, noise * y.std() * rng.standard_normal(y.shape)


@pytest.mark.statistical
def test_several_shakers_at_the_same_time():
    """H is S_yx S_xx^-1: one alone would be off by the other. Errors and a gain are as wide as they say."""
    rng, ratios, scores = np.random.default_rng(0), [], []
    for _ in range(24):
        x, y, noise = shaken(rng)
        frf = frequency_response(x, y + noise, fs=RATE, segment=4.0, band=(2.0, 90.0))
        f, v = frf["frequency"].values, frf["variance"].values
        truth = np.array([[gains(a, f) for a in row] for row in ((20.0, 50.0), (30.0, 20.0))])
        error = frf["frequency_response"].values - truth
        ratios.append(np.abs(error) ** 2 / (v / frf["variance"].attrs["factor"]))
        scores.append((error / v).real.sum(-1) / np.sqrt((1.0 / v).sum(-1) / 2.0))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)
    assert 0.8 < np.std(scores) < 1.2
    assert frf.attrs["n_averages"] == 99 and frf.attrs["duration"] == 4.0 and np.isnan(frf.attrs["blow"])
    one = frequency_response(x[:1], y, fs=RATE, segment=4.0, band=(2.0, 90.0))
    assert (
        np.abs(one["frequency_response"].values[0, 0] - truth[0, 0]).max() > 0.5
    )  # without the other shaker
    np.testing.assert_array_equal(frf["coherence"][:, 0], frf["coherence"][:, 1])
    explained = 1.0 - (noise.var() / (y + noise).var(axis=1))[:, None]
    assert 0.0 < frf["coherence"].values.mean() < 1.0 and explained.min() > 0.8


def test_one_shaker_is_as_by_scipy():
    (x, _), y, noise = shaken(np.random.default_rng(3), 5000)
    frf = frequency_response(x, y + noise, fs=RATE, segment=2.0)
    how = {"fs": RATE, "nperseg": 400}
    for k, one in enumerate(y + noise):
        f, cross = csd(x, one, **how)
        np.testing.assert_array_equal(frf["frequency"], f[1:])
        np.testing.assert_allclose(
            frf["frequency_response"][k, 0], (cross / welch(x, **how)[1])[1:], rtol=1e-9
        )
        np.testing.assert_allclose(frf["coherence"][k, 0], coherence(x, one, **how)[1][1:], rtol=1e-9)


def test_blows_of_several_shakers():
    """Bursts (reference, blow, time) that act together, each whole."""
    rng = np.random.default_rng(1)
    parts = [shaken(rng, 1600) for _ in range(6)]
    burst = np.where(np.arange(1600) < 800, 1.0, 0.0)
    x = np.array([x * burst for x, _, _ in parts]).swapaxes(0, 1)
    y = np.array([[lfilter(*filters(20.0), a) + lfilter(*filters(50.0), b)] for a, b in x.swapaxes(0, 1)])
    frf = frequency_response(x, y, fs=RATE, band=(2.0, 90.0))
    f = frf["frequency"].values
    np.testing.assert_allclose(frf["frequency_response"][0], [gains(20.0, f), gains(50.0, f)], atol=1e-9)
    assert frf.attrs["n_averages"] == 6 and np.isnan(frf.attrs["blow"])


def test_excitations_that_are_the_same():
    x, y, _ = shaken(np.random.default_rng(0), 4000)
    with pytest.raises(
        ValueError,
        match="present at all lines, and of independent references, in 9 averages, got that of 0, 1",
    ):
        frequency_response(np.array([x[0], 2.0 * x[0]]), y, fs=RATE, segment=4.0)
    frequency_response(x * [[1.0], [1e-6]], y, fs=RATE, segment=2.0)  # and in other units
    pulse = np.zeros((2, 64))
    pulse[:, 3:6] = np.array([[1.0], [3.0]]) * [
        1.0,
        2.0,
        1.0,
    ]  # whose spectrum is zero at half the sampling rate
    with pytest.raises(ValueError, match="got that of 0 at 32.0 Hz. Narrow"):
        frequency_response(pulse, pulse[:, None], fs=64.0)
    with pytest.raises(ValueError, match="independent references, in 1 averages"):
        frequency_response(x, y, fs=RATE)
    with pytest.raises(ValueError, match="must be present at all lines"):
        frequency_response(0.0 * x[0], y, fs=RATE, segment=2.0)


def test_the_motion_of_a_base():
    """As `read_channels` returns it, by the name of the channel."""
    rng = np.random.default_rng(0)
    base = rng.standard_normal(20_000)
    floors = [lfilter(*filters(f), base) for f in (20.0, 30.0)]
    coords = {"sensor": ["base", "1", "2"], "time": np.arange(base.size) / RATE}
    channels = xr.DataArray([base, *floors], coords, ("sensor", "time"), attrs={"units": "m/s^2"})
    frf = frequency_response("base", channels, segment=8.0, band=(2.0, 90.0))
    assert frf.attrs["excitation"] == "base" and frf.attrs["quantity"] == "accelerance"
    assert frf.attrs["units"] == "(m/s^2)/(m/s^2)" and frf.attrs["dt"] == 1.0 / RATE
    assert frf["response"].values.tolist() == ["1", "2"] and frf["reference"].item() == "base"
    truth = [gains(f, frf["frequency"].values) for f in (20.0, 30.0)]
    np.testing.assert_allclose(frf["frequency_response"][:, 0], truth, atol=0.02 * np.abs(truth).max())
    apart = frequency_response(channels.sel(sensor="base"), channels.sel(sensor=["1", "2"]), segment=8.0)
    assert apart["frequency_response"].sel(frequency=slice(2.0, 90.0)).identical(frf["frequency_response"])
    text = r"`excitation` must be among the channels \['base', '1', '2'\] of `response`, got \['hammer"
    with pytest.raises(ValueError, match=text):
        frequency_response("hammer", channels)


@pytest.mark.statistical
def test_bias_of_segments():
    """A peak is low by (4/3) / (B T)^2 under white noise, B = 2 zeta f."""
    rng, T, f = np.random.default_rng(0), 4.0, 20.0
    x = rng.standard_normal((40, 40_000))
    found = [
        frequency_response(one, lfilter(*filters(f), one), fs=RATE, segment=T).sel(
            frequency=f, method="nearest"
        )
        for one in x
    ]
    ratio = np.mean([frf["frequency_response"].item() for frf in found]) / gains(f, np.array([f]))[0]
    assert 1.0 - ratio.real == pytest.approx(4.0 / 3.0 / (2.0 * ZETA_1 * f * T) ** 2, rel=0.2)


@pytest.mark.statistical
@pytest.mark.parametrize("method", ["H1", "H2", "Hv"])
@pytest.mark.parametrize("place", ["response", "excitation", "both"])
def test_methods(method, place):
    """Each without bias where its noise is; elsewhere the bias that is said. Errors about it are as said."""
    rng, level, ratios, means = np.random.default_rng(0), 0.3, [], []
    signal = rng.standard_normal((60, 128))
    for _ in range(40):
        a, b = (level * rng.standard_normal(signal.shape) for _ in range(2))
        x = signal + (a if place != "response" else 0.0)
        y = 3.0 * signal + (3.0 * b if place != "excitation" else 0.0)
        frf = frequency_response(x, y[:, None], fs=1.0, method=method)
        means.append(frf["frequency_response"].values[0, 0])
        ratios.append(frf["variance"].values[0, 0])
    k = ("response", "excitation", "both").index(place)
    expected = {"H1": (1.0, 1 / 1.09, 1 / 1.09), "H2": (1.09, 1.0, 1.09)}
    expected["Hv"] = (1.09**0.5, 1.09**-0.5, 1.0)
    assert np.mean(means).real == pytest.approx(3.0 * expected[method][k], rel=0.01)
    scatter = np.mean(np.abs(means - np.mean(means, axis=0)) ** 2)
    assert np.mean(ratios) == pytest.approx(scatter, rel=0.08)


@pytest.mark.statistical
def test_noise_of_the_excitation_where_that_is_weak():
    """The variance of H2 follows the power of the excitation from line to line, as that of H1."""
    rng, found, said = np.random.default_rng(0), [], []
    weak = np.where(np.arange(65) % 8 == 4, 0.3, 1.0)
    signal = np.fft.irfft(weak * np.fft.rfft(rng.standard_normal((6, 128))))
    for _ in range(200):
        x = signal + 0.03 * rng.standard_normal(signal.shape)
        frf = frequency_response(x, 3.0 * signal[:, None], fs=1.0, method="H2", band=(0.02, 0.48))
        found.append(frf["frequency_response"].values[0, 0])
        said.append(frf["variance"].values[0, 0])
    ratio = np.mean(said, axis=0) / np.mean(np.abs(np.array(found) - 3.0) ** 2, axis=0)
    at_weak = weak[np.rint(frf["frequency"].values * 128).astype(int)] < 1.0
    assert ratio[at_weak].mean() == pytest.approx(1.0, abs=0.1)
    assert ratio[~at_weak].mean() == pytest.approx(1.0, abs=0.1)


# --- arguments --------------------------------------------------------------------------------------

X, Y, _ = hammer_test(np.random.default_rng(0), 0.5)
DIMS = "reference", "blow", "response", "time"
TIME = {"time": np.arange(X.shape[-1]) / FS}


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"method": "H3"}, "`method` must be one of H1, H2, Hv, got 'H3'"),
        ({"decay": -1.0}, "`decay` must be positive or zero"),
        ({"fs": None}, "`dt` must be given"),
        ({"fs": 0.0}, "`fs` must be positive"),
        ({"units": "g/N"}, r"`units` must be one of \(m/s\^2\)/N, .*, got 'g/N'"),
        ({"band": (1500.0, 2000.0)}, "`band` must lie between 0 and 1024 Hz"),
        ({"band": (10.1, 10.2)}, "`band` must be wider than 2 Hz between lines"),
        ({"segment": 1.0}, "`segment` must be 8 samples or more within 0.5 s"),
        ({"segment": 0.1, "decay": 1.0}, "`segment` must be 8 samples or more .* without `decay`"),
        ({"leave_out": [("0", 9)]}, r"`leave_out` must be \"doubtful\" or pairs .* \('1', 4\)"),
        ({"response": Y[:, :2]}, "`response` must be of the references, blows and samples"),
        ({"response": np.where(Y[0, 0, 0, 5] == Y, np.nan, Y)}, "`response` must be finite"),
        ({"response": xr.DataArray(Y, dims=list("abcd"))}, "`response` must be an array of reference, blow"),
        ({"excitation": X[0, 0], "response": Y[0, 0], "method": "H2", "segment": 0.01}, None),
        ({"excitation": X[:, 0], "response": Y[0, 0], "method": "H2"}, "`method` must be H1 where several"),
        (
            {"response": xr.DataArray(Y, TIME, DIMS), "fs": 10.0},
            "`dt` must be given, and",
        ),
        (
            {"response": xr.DataArray(Y, dims=DIMS, attrs={"units": "g"})},
            "`units` must be those of the response, one of m/s^2, m/s, m, got g",
        ),
        (
            {
                "response": xr.DataArray(Y, dims=DIMS, attrs={"units": "m"}),
                "units": "(m/s^2)/N",
            },
            r"`units` must be those of the response, .*, got m and m/s\^2",
        ),
    ],
)
def test_arguments_that_are_refused(arguments, match):
    given = {"excitation": X, "response": Y, "fs": FS} | arguments
    if match is None:
        frequency_response(**given)
        return
    with pytest.raises(ValueError, match=match.replace("m/s^2, m/s, m, got g", r"m/s\^2, m/s, m, got g")):
        frequency_response(**given)


def test_labels_and_dimensions_in_any_order():
    x = xr.DataArray(X, {"reference": ["1:+z", "2:-x"]}, ("reference", "blow", "time"))
    y = xr.DataArray(Y, {"reference": ["1:+z", "2:-x"], "response": ["a", "b", "c"]}, DIMS)
    frf, turned = (frequency_response(x, one, fs=FS) for one in (y, y[::-1].transpose("time", ...)))
    xr.testing.assert_equal(frf, turned)
    assert frf["reference"].values.tolist() == ["1:+z", "2:-x"] and frf["response"].values.tolist() == [
        *"abc"
    ]
    np.testing.assert_array_equal(
        frf["frequency_response"], frequency_response(X, Y, fs=FS)["frequency_response"]
    )


@pytest.mark.parametrize(
    ("units", "said"),
    [
        ("(m/s)/N", ("mobility", "force")),
        ("m/N", ("receptance", "force")),
        ("m/(m/s^2)", ("receptance", "base")),
    ],
)
def test_units(units, said):
    frf = frequency_response(X, Y, fs=FS, units=units)
    assert (frf.attrs["quantity"], frf.attrs["excitation"], frf.attrs["units"]) == (*said, units)
