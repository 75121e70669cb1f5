"""How often a lag is told of channels that have none, and found where there is one: 30 s at 200 Hz.

Events by transfer functions, from strong motions with noise of 0.1 % to weak ones with 3 % of the peak. Of
2,000 without a lag eight were told of one; 25 before leaving out parts of the record counted in the error of
a lag.
"""

import warnings

import numpy as np
import pytest
import xarray as xr

from pymc_features.exceptions import ChannelWarning
from pymc_features.signals import check_channels, low_frequency_gains

STEP, N = 0.005, 6000
DAMPING = 0.05  # the largest


def event(seed):
    """Base and floors (sensor, time) and the band below the first frequency."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    k = rng.uniform(0.7, 1.4, n)
    squares, shapes = np.linalg.eigh(
        np.diag(k + np.append(k[1:], 0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    )
    first, zeta = rng.uniform(1.5, 5.0), rng.uniform(0.005, DAMPING)
    omega = 2.0 * np.pi * first * np.sqrt(squares / squares[0])[:, None]
    t, rise = np.arange(N) * STEP, rng.uniform(2.0, 6.0)
    pulse = np.exp(-0.5 * ((t - 8.0) / rng.uniform(1.0, 4.0)) ** 2)
    envelope = t / rise * np.exp(1.0 - t / rise) if rng.random() < 0.7 else pulse
    f, ground, lowest = np.fft.rfftfreq(2 * N, STEP), rng.uniform(1.5, 5.0), rng.uniform(0.1, 0.8)
    soil = (1.0 + 1.2j * f / ground) / (1.0 - (f / ground) ** 2 + 1.2j * f / ground)
    corner = (f / lowest) ** 2 / (1.0 - (f / lowest) ** 2 + 1.4j * f / lowest)
    base = np.fft.rfft(envelope * rng.standard_normal(N), 2 * N) * soil * corner
    s = 2.0 * np.pi * f
    followed = 1.0 + (shapes * shapes.sum(axis=0)) @ (s**2 / (omega**2 - s**2 + 2j * zeta * omega * s))
    values = np.fft.irfft(np.vstack([base, followed * base]), 2 * N)[:, :N]
    noise = 0.3 * 10 ** rng.uniform(-2.5, -1.0) * np.abs(values).max()
    return values + noise * rng.standard_normal(values.shape), (max(0.3, 0.1 * first), 0.5 * first)


def labelled(values):
    names = ["base", *(f"floor{i}" for i in range(1, len(values)))]
    return xr.DataArray(values, {"sensor": names, "time": STEP * np.arange(N)}, ("sensor", "time"))


def told(values, band) -> list[str]:
    """What is said of lags."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ChannelWarning)
        check_channels(labelled(values), band, damping_ratio=DAMPING)
    return [str(w.message) for w in caught if " samples) " in str(w.message)]


@pytest.mark.statistical
def test_false_alarms_are_rarer_than_one_event_in_two_hundred():
    """Four of 300 are exceeded once in fifty at that rate."""
    assert sum(bool(told(*event(seed))) for seed in range(300)) <= 4


@pytest.mark.statistical
def test_lags_of_several_errors_are_found():
    """Nine of ten of 4.7 errors beyond what damping and a tenth of a sample explain.

    Of three errors, where the alarm is, it cannot be more than about half.
    """
    found = n = 0
    for seed in range(1000, 1100):
        values, band = event(seed)
        clean = low_frequency_gains(labelled(values), band).isel(sensor=-1)
        if clean["coherence"] < 0.5:
            continue
        lag = 4.7 * float(clean["lag_error"]) + 0.1 * STEP + DAMPING / (1.5 * np.pi * band[1])
        shift = np.exp(-2j * np.pi * np.fft.rfftfreq(2 * N, STEP) * lag)
        values[-1] = np.fft.irfft(np.fft.rfft(values[-1], 2 * N) * shift, 2 * N)[:N]
        n += 1
        found += any(f"'floor{len(values) - 1}' comes" in text for text in told(values, band))
    assert n > 60
    assert found >= 0.9 * n
