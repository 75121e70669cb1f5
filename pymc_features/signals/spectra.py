"""Averaged spectra of channels, and what they say where a structure follows its base."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.lib.stride_tricks import sliding_window_view

from pymc_features._checks import is_among, require, shown, single
from pymc_features.signals.channels import check_array, check_band, sampling_step, sensor_names

_SEGMENTS = 8  # at least, without overlap, so that a coherence means something
_BINS = 6  # frequencies of a spectrum inside the band, at least
_ENOUGH = 0.2  # of the energy of the base, in a part without gaps
_FEW = 0.05  # share of samples in gaps
# Of the variance by leaving out parts: all of it hides lags, without it one event in 80 gets a false alarm
_LEFT_OUT = 0.5
SEGMENTS = 20  # of `averaged_spectra`, half over each other
COLUMNS = ("gain", "gain_error", "lag", "lag_error", "coherence")


def low_frequency_gains(
    channels: xr.DataArray, band: tuple[float, float], *, base: str | int | None = None
) -> xr.Dataset:
    """Gain, time lag and coherence of every channel against the base, below the first natural frequency.

    There the floors move with the base, y(t) = gain x(t - lag), with gains a little above 1 that grow with
    height. The lag is that of the largest cross-correlation in whole samples, and beyond by least squares of
    the phase of the cross-spectrum, weighted by the coherence; the gain is by regression.

    Parameters
    ----------
    channels : xarray.DataArray (sensor, time)
        Absolute accelerations in one direction.
    band : tuple of float
        (from, to) [Hz]: where the base moves, and not above half of the first natural frequency.
    base : str or int, optional
        The channel to compare with, the first by default.

    Returns
    -------
    xarray.Dataset (sensor)
        `gain`, negative for an inverted sensor; `lag` [s], positive for a channel that comes late;
        `gain_error` and `lag_error`, their standard errors; `coherence`, mean over the band.

    Notes
    -----
    Damping delays the floors too, by (1 - 1/gain) zeta / (pi f_1) well below f_1. A lag in a motion of a
    single frequency is ambiguous by its period: what tells are the start and the end of the motion.

    Of a channel with gaps, NaN, the part between two of them counts in which the base moves most; where these
    are short, all of it, at rest in the gaps, if less than 5 % is missing, and else all numbers are NaN.

    References
    ----------
    Bendat and Piersol, Random Data, 4th ed., sections 5.2 (delays) and 9.2 (errors of gain and phase).
    """
    step = sampling_step(check_array(channels, sensors=True))
    low, high = check_band(band, step)
    names = [str(name) for name in sensor_names(channels)]
    values = channels.values.astype(np.float64)
    x = values[base_index(channels, base)]
    shortest = max(_BINS / (high - low), 2.0 / low) / step
    size = max(x.size // _SEGMENTS, int(np.ceil(shortest)))
    if x.size < 2 * size:
        what = f"{2 * size * step:.3g} s for the band {low:g} to {high:g} Hz, got {x.size * step:.3g} s"
        raise ValueError(f"`channels` must last at least {what}. Widen the band or take a longer window.")
    parts = [where_both(x, y, 2 * size) for y in values]
    unknown = (np.nan,) * len(COLUMNS)
    rows = [unknown if part is None else _compare(*part, step, (low, high), size) for part in parts]
    found = xr.Dataset(coords={"sensor": names}, attrs={"band": [low, high]})
    for name, numbers in zip(COLUMNS, np.transpose(rows), strict=True):
        found[name] = ("sensor", numbers, {"units": "s"} if name.startswith("lag") else {})
    return found


def where_both(x, y, shortest: int):
    """What two series (time,) say without gaps, by `low_frequency_gains`; None if that is too little."""
    gaps = np.isnan(x) | np.isnan(y)
    if not gaps.any():
        return x, y
    about = np.nan_to_num(x - np.nanmean(x)) ** 2
    edges = np.flatnonzero(np.diff(np.r_[True, gaps, True].astype(np.int8)))
    long = [(a, b) for a, b in edges.reshape(-1, 2) if b - a >= shortest]
    first, last = max(long, key=lambda part: about[slice(*part)].sum(), default=(0, 0))
    if about[first:last].sum() > _ENOUGH * about.sum():
        return x[first:last], y[first:last]
    if gaps.mean() > _FEW:
        return None
    return tuple(np.where(gaps, 0.0, z - z[~gaps].mean()) for z in (x, y))  # y = gain x stays so


def base_index(channels: xr.DataArray, base) -> int:
    """Place of the base among the sensors."""
    names = sensor_names(channels)
    if base is None:
        return 0
    what = f"one of the sensors {', '.join(map(repr, map(str, names)))}, got {shown(base)}"
    require(is_among(base, names), f"`base` must be {what}.")
    return names.index(single(base))


def _compare(x, y, step, band, size) -> tuple[float, float, float, float, float]:
    """Gain, its error, lag, its error and coherence of y (time,) against x (time,)."""
    shift, sign = _whole_lag(x, y, step, band)
    x, y = (x[: x.size - shift], y[shift:]) if shift >= 0 else (x[-shift:], y[:shift])
    size = min(size, x.size)
    frequencies = np.fft.rfftfreq(size, step)
    inside = (frequencies >= band[0]) & (frequencies <= band[1])
    omega = 2.0 * np.pi * frequencies[inside]
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi / size * np.arange(size))  # of Hann
    at_x, at_y = windowed_spectra(np.array([[x, y]]), window)[..., inside].swapaxes(0, 1)
    terms = sign * np.conj(at_x) * at_y, np.abs(at_x) ** 2, np.abs(at_y) ** 2
    cross, power_x, power_y = (z.sum(axis=0) for z in terms)
    rest, weights, scatter, coherence = _lag(cross, power_x, power_y, omega, x.size / size)
    gain = (cross * np.exp(1j * omega * rest)).real.sum() / power_x.sum()
    # neighbours of a Hann window are correlated: two thirds as many independent ones
    lag_variance = 1.5 * (weights**2 * scatter / omega**2).sum() / weights.sum() ** 2
    gain_variance = 1.5 * (power_x**2 * scatter).sum() / power_x.sum() ** 2
    # coherence tells neither of power that comes from other frequencies nor of one part that holds most of it
    left_out = _lag(*(z.sum(axis=0) - z for z in terms), omega, x.size / size)[0]
    lag_variance += _LEFT_OUT * (len(at_x) - 1) * left_out.var()
    gain_error, lag_error = abs(gain) * np.sqrt(gain_variance), np.sqrt(lag_variance)
    mean_coherence = (coherence * power_x).sum() / power_x.sum()
    return sign * gain, gain_error, shift * step + rest, lag_error, mean_coherence


def windowed_spectra(values: np.ndarray, window: np.ndarray) -> np.ndarray:
    """Spectra (average, channel, line) of records (blow, channel, time), whole or in segments less mean."""
    size = window.size
    if window[0] == 0.0:  # of Hann
        parts = sliding_window_view(values, size, axis=-1)[:, :, :: size - size // 2].swapaxes(1, 2)
        values = (parts - parts.mean(-1, keepdims=True)).reshape(-1, values.shape[1], size)
    return np.fft.rfft(values * window)


def _lag(cross, power_x, power_y, omega, n) -> tuple[np.ndarray, ...]:
    """Lag [s] by the phases of spectra (..., frequency); their weights, variances, and the coherence."""
    coherence = np.abs(cross) ** 2 / np.maximum(power_x * power_y, np.finfo(float).tiny)
    scatter = np.maximum(1.0 - coherence, 0.0) / np.maximum(2.0 * coherence * n, 1e-12)  # of a phase
    weights = omega**2 / (scatter + 1e-12)
    lag = -(weights * np.angle(cross) / omega).sum(axis=-1) / weights.sum(axis=-1)
    return lag, weights, scatter, coherence


def _whole_lag(x, y, step, band) -> tuple[int, float]:
    """Lag in samples, and sign, of the largest cross-correlation within the band, up to a quarter record."""
    n = x.size
    frequencies = np.fft.rfftfreq(2 * n, step)
    inside = (frequencies >= band[0]) & (frequencies <= band[1])
    spectra = [np.fft.rfft(z - z.mean(), 2 * n) * inside for z in (x, y)]
    correlation = np.fft.irfft(np.conj(spectra[0]) * spectra[1], 2 * n)
    lags = np.arange(-(n // 4), n // 4 + 1)
    best = int(lags[np.argmax(np.abs(correlation[lags]))])
    return best, 1.0 if correlation[best] >= 0.0 else -1.0


class Spectra(NamedTuple):
    """Spectra that are averaged over twenty parts of a record, half over each other (Welch, Hann windows)."""

    frequencies: np.ndarray  # (k,) [Hz]
    matrices: np.ndarray  # (k, s, s), of all channels against each other, one-sided [unit^2/Hz]
    length: int  # samples of a part

    @property
    def singular_values(self) -> np.ndarray:
        """Singular values of the matrices, largest first (k, s) [unit^2/Hz]."""
        return np.linalg.eigvalsh(self.matrices)[:, ::-1].clip(min=0.0)


def averaged_spectra(values: np.ndarray, dt: float) -> Spectra:
    """Spectra of channels (s, t) without gaps."""
    from scipy import signal  # a second to import

    length = min(values.shape[1], 2 * values.shape[1] // (SEGMENTS + 1))
    f, matrices = signal.csd(values[:, None], values[None], 1.0 / dt, nperseg=length)
    return Spectra(f, matrices.transpose(2, 0, 1), length)
