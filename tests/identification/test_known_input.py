"""Modes identified from channels and their excitation: intervals, close modes, shakers and bases."""

import numpy as np
import pytest
import xarray as xr
from scipy.linalg import expm
from scipy.signal import lfilter, resample, ss2tf

import pymc_features as pmf
from benchmarks import truth
from pymc_features.exceptions import AmbientWarning

RATE, MATRICES = 50.0, truth.chain_matrices(np.ones(4), np.full(4, 1200.0), (0.1, 0.0008))
BANDS = [(1.0, 3.7), (3.8, 6.9), (7.0, 9.4), (9.5, 12.0)]  # Hz; modes are at 1.9, 5.5, 8.4 and 10.4


def channels(values, names, rate=RATE):
    """As `read_channels` returns them."""
    coords = {"sensor": list(names), "time": np.arange(np.shape(values)[1]) / rate}
    return xr.DataArray(values, coords, ("sensor", "time"))


def earthquake(seed):
    """Four floors under a motion of the base, by transfer functions of modes; 2 % noise."""
    motion = truth.motion(RATE, 60.0, seed)
    y = truth.response(MATRICES, motion)["absolute_acceleration"]
    y = y + 0.02 * y.std() * np.random.default_rng(seed).standard_normal(y.shape)
    return channels(y, "abcd"), channels(motion.values(), "g")


def expected():
    """Frequencies [Hz], damping ratios and shapes (mode, floor) of length one."""
    w, shapes = truth.modes(MATRICES.mass, MATRICES.stiffness)[:2]
    w, shapes = np.ravel(w), np.reshape(shapes, (4, 4)).T
    return (
        w / (2.0 * np.pi),
        0.5 * (0.1 / w + 0.0008 * w),
        shapes / np.linalg.norm(shapes, axis=1, keepdims=True),
    )


@pytest.mark.statistical
@pytest.mark.slow
def test_an_earthquake():
    """Each mode once in 8 records, 64 numbers as wide as said (false alarms 1e-2). Control: half."""
    f, zeta, shapes = expected()
    z = []
    for seed in range(8):
        floors, base = earthquake(seed)
        found = pmf.identify_modes(floors, BANDS, excitation=base)
        assert len(found.frequencies) == 4
        z.append((found.frequencies - f) / found.frequency_sd)
        z.append((found.damping_ratios - zeta) / found.damping_sd)
        mac = np.sum(found.shapes * shapes, axis=1) ** 2
        assert mac.min() > 0.99
    spread = np.sqrt(np.mean(np.square(z)))
    assert 0.75 < spread < 1.3 < 2.0 * spread


def test_names_of_channels_say_the_same():
    """The excitation among the channels, or beside them."""
    floors, base = earthquake(1)
    one = pmf.identify_modes(floors, BANDS, excitation=base)
    both = xr.concat([base, floors], "sensor")
    other = pmf.identify_modes(both, BANDS, excitation="g")
    np.testing.assert_allclose(other.frequencies, one.frequencies, rtol=1e-12)
    assert other.channels == one.channels


def shaken(seed, n=6000, dt=0.05, fine=32):
    """Close modes of 1.00 and 1.02 Hz under two band-limited forces, in steps of dt / 32; 5 % noise."""
    rng = np.random.default_rng(seed)
    forces = resample(rng.standard_normal((2, n // 2)), n, axis=1)
    shapes, inputs = np.array([[1.0, 0.6, -0.3], [0.4, -0.8, 1.0]]), np.array([[1.0, 0.3], [-0.5, 1.0]])
    y = np.zeros((3, n))
    for f, shape, part in zip((1.0, 1.02), shapes, inputs, strict=True):
        w = 2.0 * np.pi * f
        whole = np.zeros((3, 3))
        whole[0, 1], whole[1] = 1.0, [-(w**2), -0.02 * w, 1.0]
        step = expm(whole * dt / fine)
        b, a = ss2tf(step[:2, :2], step[:2, 2:], np.eye(2)[:1], np.zeros((1, 1)))
        force = resample(part @ forces, n * fine)
        y += shape[:, None] * lfilter(b[0], a, 0.5 * (force + np.roll(force, -1)))[::fine]
    y += 0.05 * y.std() * rng.standard_normal(y.shape)
    return channels(y, "abc", 1.0 / dt), channels(forces, "uv", 1.0 / dt), shapes


def test_close_modes_under_two_forces():
    """Both, with their shapes, within 5 sds."""
    y, forces, shapes = shaken(1)
    found = pmf.identify_modes(y, [(0.8, 1.25)], quantity="displacement", excitation=forces)
    assert np.all(np.abs(found.frequencies - [1.0, 1.02]) < 5.0 * found.frequency_sd)
    assert np.all(np.abs(found.damping_ratios - 0.01) < 5.0 * found.damping_sd)
    expected_shapes = shapes / np.linalg.norm(shapes, axis=1, keepdims=True)
    assert (np.sum(found.shapes * expected_shapes, axis=1) ** 2).min() > 0.999
    assert (
        pmf.identify_modes(
            y, [(0.8, 1.25)], n_modes=1, quantity="displacement", excitation=forces
        ).frequencies.size
        == 1
    )


def test_what_is_refused():
    """Excitations that do not fit; a band of noise is named."""
    floors, base = earthquake(1)
    with pytest.raises(ValueError, match="`excitation` must be some of the channels a, b, c, d"):
        pmf.identify_modes(floors, BANDS, excitation="base")
    with pytest.raises(ValueError, match="`excitation` must be .* samples at 0.02 s"):
        pmf.identify_modes(floors, BANDS, excitation=base.isel(time=slice(None, None, 2)))
    noise = channels(np.random.default_rng(1).standard_normal((2, 3000)), "ab")
    with (
        pytest.warns(AmbientWarning, match="has no mode"),
        pytest.raises(ValueError, match="bands with modes"),
    ):
        pmf.identify_modes(noise, [(2.0, 4.0)], excitation=base.isel(time=slice(3000)))
