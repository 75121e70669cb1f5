"""Bands around the peaks of the singular values of the spectra, and machines that are no modes."""

import numpy as np
import xarray as xr
from scipy.fft import next_fast_len

from pymc_features._checks import check_positive, message
from pymc_features.signals import sampling_step
from pymc_features.signals.channels import whole_values
from pymc_features.signals.spectra import averaged_spectra

PROMINENCE = 6.0  # dB above the valleys beside a peak
HALF_WIDTH = 0.06  # of a band, relative to the frequency of its peak
FEWEST = 3.0  # resolutions of the averaged spectrum on each side


def propose_bands(channels: xr.DataArray, *, highest: float | None = None) -> np.ndarray:
    """Bands around the peaks of the first singular value of the spectra, to begin with.

    Spectra are averaged over twenty parts of the record (Welch); a peak stands 6 dB above the valleys on both
    of its sides. The lowest band does not begin below the valley beside a drift. Look at the bands in the
    spectra: a machine is a peak as well.

    Parameters
    ----------
    channels : DataArray (sensor, time)
        As `read_channels` returns them.
    highest : float, optional
        Frequency [Hz] up to which to look; 0.4 of the sampling rate by default.

    Returns
    -------
    array (band, 2)
        Lower and upper ends [Hz], apart from each other.

    Raises
    ------
    ValueError
        If there is no peak.
    """
    from scipy import signal  # a second to import

    values, dt = whole_values(channels), sampling_step(channels)
    highest = 0.4 / dt if highest is None else check_positive(highest, "highest", "Pass it in Hz.")
    spectra = averaged_spectra(values, dt)
    f, first = spectra.frequencies, spectra.singular_values[:, 0]
    inside = (f > 0.0) & (f <= highest)
    f, level = f[inside], 10.0 * np.log10(np.maximum(first[inside], np.finfo(float).tiny))
    peaks, _ = signal.find_peaks(level, prominence=PROMINENCE)
    if not peaks.size:
        raise ValueError(
            message(
                "channels",
                "of a structure that moves in its modes",
                "spectra without a peak",
                "Pass `bands`.",
            )
        )
    half = np.maximum(HALF_WIDTH * f[peaks], FEWEST * (f[1] - f[0]))
    bands = np.column_stack([np.maximum(f[peaks] - half, 0.5 * f[0]), np.minimum(f[peaks] + half, 0.49 / dt)])
    valley = int(level[: peaks[0]].argmin())
    if np.interp(bands[0, 0], f, level) > level[valley] + PROMINENCE:  # in the drift
        bands[0, 0] = f[valley]
    joined = [bands[0]]
    for low, high in bands[1:]:
        if low <= joined[-1][1]:
            joined[-1] = np.array([joined[-1][0], high])
        else:
            joined.append(np.array([low, high]))
    return np.array(joined)


# --- machines at constant speed: sines in a record, found in its spectrum and taken off -------------------

FINER = 4  # frequencies of the padded spectrum for one of the record
BESIDE = np.arange(3, 9)  # frequencies of the record away, on both sides, with which a peak is compared
HIGHER = 60.0  # than the mean there: noise is so once in 1e8 frequencies, a mode 2.4 of them wide once in 40
MOST = 50
LOWEST = 10  # frequencies of the record below which a peak may be a drift


def without_tones(values: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Channels (s, n) without means and sines, and the frequencies of these [Hz], ascending.

    A sine looks as a record of its length makes it: it falls to 1/470 of its height, in the mean, between
    three and eight frequencies away. A mode does so only if it is narrower than a frequency. Each channel
    loses one of an amplitude and a phase of its own.
    """
    values, found = values - values.mean(axis=1, keepdims=True), []
    while len(found) < MOST and (f := highest_tone(values, dt)) is not None:
        columns = waves(f, values.shape[1], dt)
        values = values - np.linalg.lstsq(columns, values.T)[0].T @ columns.T
        found.append(f)
    return values, np.array(sorted(found))


def highest_tone(values, dt) -> float | None:
    """Frequency [Hz] of the sine that stands highest above what is beside it; None if there is none."""
    n = values.shape[1]
    size = next_fast_len(FINER * n)
    power = (np.abs(np.fft.rfft(values, size)) ** 2).sum(axis=0)
    step = size / n  # of the padded spectrum in a frequency of the record
    apart = np.round(step * BESIDE).astype(int)
    inside = np.arange(int(LOWEST * step), power.size - apart[-1])
    beside = [power[inside[:, None] + sign * apart].mean(axis=1) for sign in (-1, 1)]
    ratio = power[inside] / np.maximum(np.maximum(*beside), np.finfo(float).tiny)
    best = int(ratio.argmax())
    if ratio[best] < HIGHER:
        return None
    from scipy import optimize  # a second to import

    def minus_energy(f):
        return -np.sum((waves(f, n, dt).T @ values.T) ** 2)

    middle, half = inside[best] / (size * dt), 0.5 / (n * dt)
    found = optimize.minimize_scalar(
        minus_energy, bounds=(middle - half, middle + half), method="bounded", options={"xatol": 1e-3 * half}
    )
    return float(found.x)


def waves(f, n, dt) -> np.ndarray:
    """Cosine and sine (n, 2)."""
    phase = 2.0 * np.pi * f * dt * np.arange(n)
    return np.column_stack([np.cos(phase), np.sin(phase)])
