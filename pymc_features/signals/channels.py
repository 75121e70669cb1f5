"""Channels on one even clock, NaN in gaps: their rules, and cuts, filters, rates and corrections of them."""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from pymc_features._checks import (
    as_list,
    check_choice,
    check_finite,
    check_integer,
    check_number,
    is_number,
    message,
    shown,
    single,
    to_float,
    warn_caller,
)
from pymc_features.exceptions import ChannelWarning


def warn_channel(message: str) -> None:
    """Warn at the line that called into this package from outside."""
    warn_caller(message, ChannelWarning)


def check_array(channels, sensors: bool = False) -> xr.DataArray:
    """Return channels as they came; refuse what is no array (sensor, time) or (time,) of finite numbers.

    NaN is a gap, but not all of a channel. With `sensors`, a single channel without the dimension sensor is
    refused too.
    """
    if not isinstance(channels, xr.DataArray):
        raise TypeError(
            f"`channels` must be an xarray.DataArray (sensor, time), got {type(channels).__name__}. "
            "Read files with `read_channels`."
        )
    allowed = [("sensor", "time")] if sensors else [("sensor", "time"), ("time",)]
    if channels.dims not in allowed:
        raise ValueError(
            f"`channels` must have dimensions {' or '.join(map(str, allowed))}, got {channels.dims}. "
            "Transpose or rename them: time is the last."
        )
    if channels.dtype.kind not in "iuf":
        raise TypeError(f"`channels` must hold numbers, got {channels.dtype}.")
    if not channels.size:
        raise ValueError(f"`channels` must hold samples, got shape {channels.shape}.")
    gaps = np.isnan(channels.values)
    check_finite(np.where(gaps, 0.0, channels.values), "channels", "NaN is a gap.")
    silent = np.flatnonzero(gaps.all(axis=-1))
    if len(silent):
        got = f"NaN alone in {str(sensor_names(channels)[silent[0]])!r}"
        raise ValueError(f"`channels` must have samples of every sensor, got {got}. Leave it out.")
    names = [str(name) for name in channels["sensor"].values] if sensors else []
    if len(set(names)) < len(names):
        raise ValueError(f"`channels` must have a name of its own for each sensor, got {', '.join(names)}.")
    return channels


def sensor_names(channels: xr.DataArray) -> list:
    """Labels of the sensors, counted where they have none."""
    known = "sensor" in channels.coords
    return list(np.ravel(channels.coords["sensor"]) if known else range(channels.sizes.get("sensor", 1)))


def whole_values(channels) -> np.ndarray:
    """Numbers (sensor, time) of channels; refuse those with gaps."""
    values = check_array(channels, sensors=True).values.astype(np.float64)
    check_finite(values, "channels", "Cut the record where there are gaps.")
    return values


def sampling_step(channels: xr.DataArray) -> float:
    """Sampling interval [s] of channels, from their time coordinate, even to a thousandth."""
    check_array(channels)
    if "time" not in channels.coords or channels.sizes["time"] < 2:
        raise ValueError(
            "`channels` must have a time coordinate [s] of at least 2 samples, got "
            f"{channels.sizes['time']} samples and coordinates {list(channels.coords)}."
        )
    if channels["time"].dtype.kind not in "iuf":
        raise TypeError(
            f"`channels` must have times in seconds, got a time coordinate of type {channels['time'].dtype}. "
            "Pass seconds from the first sample."
        )
    time = np.asarray(channels["time"].values, dtype=np.float64)
    step = (time[-1] - time[0]) / (time.size - 1)
    uneven = np.abs(time - time[0] - step * np.arange(time.size))
    if not (step > 0.0 and uneven.max() <= 1e-3 * step):
        steps = np.diff(time)
        raise ValueError(
            f"`channels` must be evenly sampled, their steps vary from {steps.min():.4g} s to "
            f"{steps.max():.4g} s. Resample them first."
        )
    return float(f"{step:.10g}")


def rebuilt(channels: xr.DataArray, values: np.ndarray, step: float, start: float = 0.0) -> xr.DataArray:
    """Give the sensors other values (..., time): time from 0, `start` [s] later than it was."""
    coords = {name: c for name, c in channels.coords.items() if "time" not in c.dims}
    attrs = channels.attrs | {"start": float(channels.attrs.get("start", 0.0)) + start}
    time = ("time", step * np.arange(values.shape[-1]), {"units": "s"})
    return xr.DataArray(values, coords | {"time": time}, channels.dims, channels.name, attrs)


def check_window(channels: xr.DataArray, window, name: str = "window") -> tuple[int, int]:
    """First and one past the last sample of a window (from, to) [s], both ends included."""
    step = sampling_step(channels)
    first, last = check_pair(window, name, "two times (from, to) in seconds")
    begin, end = float(channels["time"][0]), float(channels["time"][-1])
    slack = 1e-6 * step
    if not begin - slack <= first < last <= end + slack:
        raise ValueError(
            f"`{name}` must lie within the record, {begin:g} s to {end:g} s, and run forward, got "
            f"({first:g}, {last:g}). Times are those of the coordinate `time`."
        )
    low = int(np.ceil((first - begin) / step - 1e-6))
    high = int(np.floor((last - begin) / step + 1e-6)) + 1
    if high - low < 2:
        got = f"({first:g}, {last:g}) at a step of {step:g} s"
        raise ValueError(f"`{name}` must hold at least 2 samples, got {got}.")
    return low, high


def check_frequency(value, name: str, nyquist: float) -> float:
    """A frequency [Hz] between 0 and half the sampling rate."""
    frequency = check_number(value, name, "Pass a frequency in Hz.")
    if not 0.0 < frequency < nyquist:
        between = f"between 0 and {nyquist:g} Hz, half the sampling rate"
        raise ValueError(f"`{name}` must lie {between}, got {frequency:g}.")
    return frequency


def check_band(band, step: float) -> tuple[float, float]:
    """Two rising frequencies [Hz] below half the sampling rate."""
    edges = check_pair(band, "band", "two frequencies (from, to) in Hz")
    low, high = (check_frequency(edge, "band", 0.5 / step) for edge in edges)
    if not low < high:
        raise ValueError(f"`band` must rise, got ({low:g}, {high:g}) Hz.")
    return low, high


def check_pair(pair, name: str, what: str) -> tuple[float, float]:
    """Two numbers."""
    numbers = [single(number) for number in as_list(pair) or []]
    if len(numbers) != 2 or not all(map(is_number, numbers)):
        raise TypeError(message(name, what, shown(pair)))
    return to_float(numbers[0]), to_float(numbers[1])


def filled(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (..., time) with straight lines across the gaps, and where these are, bool (..., time).

    A gap at an end takes the value nearest to it. Without gaps the values are those given.
    """
    gaps = np.isnan(values)
    if not gaps.any():
        return values, gaps
    whole = np.array(values, dtype=np.float64).reshape(-1, values.shape[-1])
    at = np.arange(whole.shape[1])
    for row, missing in zip(whole, gaps.reshape(whole.shape), strict=True):
        row[missing] = np.interp(at[missing], at[~missing], row[~missing])
    return whole.reshape(values.shape), gaps


def widened(gaps: np.ndarray, samples: int) -> np.ndarray:
    """Gaps (..., time) that begin as many samples earlier and end as many later."""
    if samples == 0 or not gaps.any():
        return gaps
    near = np.pad(gaps, [(0, 0)] * (gaps.ndim - 1) + [(samples + 1, samples)])
    count = np.cumsum(near, axis=-1)
    return count[..., 2 * samples + 1 :] > count[..., : -2 * samples - 1]


# ---- what is done to channels ----


def trim(channels: xr.DataArray, start: float, stop: float) -> xr.DataArray:
    """Channels within a window of time, both ends included.

    Parameters
    ----------
    channels : xarray.DataArray (sensor, time) or (time,)
        Measured channels.
    start, stop : float
        First and last time kept [s], by the coordinate `time`, within the record.

    Returns
    -------
    xarray.DataArray (sensor, time) or (time,)
        With times from 0; `attrs["start"]` grows by what was cut at the front [s].

    Notes
    -----
    The models of this package are at rest at the first sample: start the window where the structure is.

    Examples
    --------
    >>> import numpy as np
    >>> ramp = xr.DataArray(np.arange(5.0), dims="time", coords={"time": 0.1 * np.arange(5)})
    >>> trim(ramp, 0.1, 0.3).values
    array([1., 2., 3.])
    """
    low, high = check_window(channels, (start, stop), "start, stop")
    step = sampling_step(channels)
    return rebuilt(channels, channels.values[..., low:high].copy(), step, low * step)


_DEGREES = {"constant": 0, "linear": 1}


def detrend(
    channels: xr.DataArray, kind: str = "constant", *, window: tuple[float, float] | None = None
) -> xr.DataArray:
    """Channels less their offset, or less the straight line of least squares.

    Parameters
    ----------
    channels : xarray.DataArray (sensor, time) or (time,)
        Measured channels.
    kind : str
        "constant", such as the share of gravity in a tilted sensor, or "linear", a slow drift besides.
    window : tuple of float, optional
        (from, to) [s] to take offset or line from, such as the quiet time before the shaking, where the mean
        of a short record is not its offset; two samples of each channel at least. The whole by default.

    Returns
    -------
    xarray.DataArray
        Of the same shape. Of a channel with gaps, NaN, the samples that were measured count.

    Examples
    --------
    >>> ramp = xr.DataArray([1.0, 2.0, 4.0], dims="time", coords={"time": [0.0, 0.1, 0.2]})
    >>> detrend(ramp, window=(0.0, 0.1)).values
    array([-0.5,  0.5,  2.5])
    """
    check_choice(kind, "kind", _DEGREES)
    step = sampling_step(channels)
    low, high = (0, channels.sizes["time"]) if window is None else check_window(channels, window)
    # about the middle of the window, in units of its half: offset and slope are then orthogonal
    place = (np.arange(channels.sizes["time"]) - (low + high - 1) / 2.0) / max((high - low) / 2.0, 1.0)
    powers = place ** np.arange(_DEGREES[kind] + 1)[:, None]  # (power, time)
    values = channels.values.astype(np.float64)
    whole, gaps = (np.atleast_2d(x) for x in filled(values))
    fit = np.linalg.lstsq(powers[:, low:high].T, whole[:, low:high].T)[0]
    for i in np.flatnonzero(gaps.any(axis=1)):
        known = low + np.flatnonzero(~gaps[i, low:high])
        if known.size < 2:
            raise ValueError(
                f"`window` must hold at least 2 samples of every channel, got {known.size} of channel {i}, "
                "which has a gap there. Choose another."
            )
        fit[:, i] = np.linalg.lstsq(powers[:, known].T, whole[i, known])[0]
    return rebuilt(channels, values - (fit.T @ powers).reshape(values.shape), step)


HIGHEST = 10  # order; beyond it rounding moves gains by per cents where a corner is a thousandth of the rate


def band_pass(
    channels: xr.DataArray, low: float | None = None, high: float | None = None, *, order: int = 4
) -> xr.DataArray:
    """Channels within a band of frequencies, by a Butterworth filter run forward and backward.

    Parameters
    ----------
    channels : xarray.DataArray (sensor, time) or (time,)
        Measured channels.
    low, high : float, optional
        Corner frequencies [Hz], between 0 and half the sampling rate. Without `low` a low-pass, without
        `high` a high-pass.
    order : int
        Of the Butterworth filter, 1 to 10. Both runs together have the gain 1 / (1 + (f / high)^(2 order))
        of a low-pass, so 1/2 at the corner.

    Returns
    -------
    xarray.DataArray
        Of the same shape; nothing is shifted in time. Gaps, NaN, are wider by one period of the lowest corner
        on each side, where the filter remembers the straight line that it found in their place.

    Notes
    -----
    `scipy.signal.sosfiltfilt` with its odd extension at the ends; expect errors there for about one period of
    the lower corner. Filter excitation and response alike: a linear structure then has the same transfer
    function between them. A high-pass also removes the static offset.
    """
    from scipy import signal  # a second to import

    step = sampling_step(channels)
    nyquist = 0.5 / step
    if low is None and high is None:
        raise ValueError("`low` or `high` must be given, got neither. Pass corner frequencies in Hz.")
    named = {name: corner for name, corner in (("low", low), ("high", high)) if corner is not None}
    corners = [check_frequency(corner, name, nyquist) for name, corner in named.items()]
    if len(corners) == 2 and not corners[0] < corners[1]:
        raise ValueError(f"`low` must be below `high`, got {corners[0]:g} and {corners[1]:g} Hz.")
    order = check_integer(order, "order", most=HIGHEST)
    kind = "bandpass" if len(corners) == 2 else "lowpass" if low is None else "highpass"
    edges = corners if len(corners) == 2 else corners[0]
    sections = signal.butter(order, edges, kind, output="sos", fs=1.0 / step)
    shortest = 3 * (2 * len(sections) + 1)
    if channels.sizes["time"] <= shortest:
        raise ValueError(
            f"`channels` must have more than {shortest} samples for this filter, got "
            f"{channels.sizes['time']}. Lower `order`, or filter before trimming."
        )
    try:
        values, gaps = filled(channels.values.astype(float))
        filtered = signal.sosfiltfilt(sections, values)
    except ValueError as error:  # a pole at 1, to rounding
        raise ValueError(
            f"`{next(iter(named))}` must not be so far below the sampling rate, {1.0 / step:g} Hz, got "
            f"{corners[0]:g} Hz: the filter cannot be computed. Subtract a line or an offset instead."
        ) from error
    gaps = widened(gaps, int(np.ceil(1.0 / (corners[0] * step))))
    return rebuilt(channels, np.where(gaps, np.nan, filtered), step)


_HALF_LENGTH = 20  # of the filter, in samples of the result
_KAISER = 7.86  # 80 dB in the stop band, over a transition of a quarter of half the new rate
_CORNER = 0.875  # middle of the transition, of half the new rate


def decimate(channels: xr.DataArray, factor: int) -> xr.DataArray:
    """Every `factor`-th sample of channels, after a low-pass that no frequency above the new limit passes.

    Parameters
    ----------
    channels : xarray.DataArray (sensor, time) or (time,)
        Measured channels.
    factor : int
        Positive; the record must be as long as the filter, 40 factor + 1 samples.

    Returns
    -------
    xarray.DataArray
        Samples 0, factor, 2 factor, ... in time. Gaps, NaN, are wider by 20 new samples on each side, as far
        as the filter reaches.

    Notes
    -----
    A symmetric filter of 40 factor + 1 coefficients (Kaiser window), so without phase: within 1e-3 of 1 up to
    3/4 of half the new sampling rate, below 1e-3 from half the new rate on (tests/signals/test_signals.py).
    The straight line through first and last sample bypasses it; expect errors within 20 new samples of the
    ends.

    Decimate measured floors as far as you like; the base keeps its step, for `response(..., dt=)` has one of
    its own. Modes above half the new rate are not excited by a base that was decimated.
    """
    from scipy import signal  # a second to import

    factor = check_integer(factor, "factor", advice="2 halves the sampling rate.")
    step = sampling_step(check_array(channels))
    values, gaps = filled(channels.values.astype(np.float64))
    if factor > 1:
        length = 2 * _HALF_LENGTH * factor + 1
        if values.shape[-1] < length:
            raise ValueError(
                f"`channels` must have at least {length} samples to be decimated by {factor}, got "
                f"{values.shape[-1]}. Decimate before trimming."
            )
        window = signal.firwin(length, _CORNER / factor, window=("kaiser", _KAISER))
        values = signal.resample_poly(values, 1, factor, axis=-1, window=window, padtype="line")
        gaps = widened(gaps, _HALF_LENGTH * factor)[..., ::factor]
    return rebuilt(channels, np.where(gaps, np.nan, values), factor * step)


_REACH = 10  # samples of a shift by a part of one


def correct(
    channels: xr.DataArray,
    *,
    scale: float | Mapping[str, float] | None = None,
    delay: Mapping[str, float] | None = None,
) -> xr.DataArray:
    """Multiply channels by factors, and shift those that come late.

    Parameters
    ----------
    channels : xarray.DataArray (sensor, time)
        Measured channels.
    scale : float or mapping of str to float, optional
        Factor [-] for all sensors, or by name, not zero: -1 for an inverted one.
    delay : mapping of str to float, optional
        How late a sensor comes [s], by name, negative if early, any fraction of a sample, at most a quarter
        of the record. The channel is shifted back by as much.

    Returns
    -------
    xarray.DataArray (sensor, time)
        With the times of the input.

    Notes
    -----
    Shifts are exact for signals below half the sampling rate (a factor exp(i omega delay) of the Fourier
    transform). What a shift would take from beyond an end of the record has the value of that end. Gaps, NaN,
    are shifted too; where the shift is no number of whole samples they are wider by ten samples on each side.

    Examples
    --------
    >>> import numpy as np
    >>> channels = xr.DataArray(
    ...     [[0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, -2.0, 0.0, 0.0]],
    ...     dims=("sensor", "time"),
    ...     coords={"sensor": ["base", "roof"], "time": 0.5 * np.arange(6)},
    ... )
    >>> correct(channels, scale={"roof": -0.5}, delay={"roof": 0.5}).values[1].round(12) + 0.0
    array([0., 0., 1., 0., 0., 0.])
    """
    check_array(channels, sensors=True)
    names, step = [str(name) for name in sensor_names(channels)], sampling_step(channels)
    scale = 1.0 if scale is None else single(scale)
    factors = _by_sensor(dict.fromkeys(names, scale) if is_number(scale) else scale, "scale", names)
    values, most = channels.values.astype(np.float64), 0.25 * step * channels.sizes["time"]
    for name, factor in factors.items():
        if factor == 0.0:
            raise ValueError(f"`scale` must not be zero, got 0 for {name!r}. Leave the sensor out instead.")
        values[names.index(name)] *= factor
    for name, late in _by_sensor({} if delay is None else delay, "delay", names).items():
        if abs(late) > most:
            raise ValueError(
                f"`delay` must be at most a quarter of the record, {most:.4g} s, got {late:g} s for "
                f"{name!r}. Cut the files to the same time instead."
            )
        samples, nearest = late / step, round(late / step)
        whole, gaps = filled(values[names.index(name)])
        moved = earlier(whole, samples)
        if gaps.any():
            gaps = earlier(gaps.astype(np.float64), nearest) > 0.0
            moved[gaps if nearest == samples else widened(gaps, _REACH)] = np.nan
        values[names.index(name)] = moved
    return rebuilt(channels, values, step, 0.0).assign_coords(time=channels["time"])


def _by_sensor(given, name, sensors) -> dict[str, float]:
    """Numbers by sensor."""
    values = [single(value) for value in given.values()] if isinstance(given, Mapping) else [None]
    if not all(is_number(value) and np.isfinite(to_float(value)) for value in values):
        raise TypeError(f"`{name}` must be a mapping of sensors to finite numbers, got {shown(given)}.")
    numbers = dict(zip(given, map(to_float, values), strict=True))
    if unknown := [sensor for sensor in numbers if sensor not in sensors]:
        raise ValueError(f"`{name}` must name sensors among {', '.join(sensors)}, got {unknown[0]!r}.")
    return numbers


def earlier(series, samples: float) -> np.ndarray:
    """A series (time,) with constant ends shifted forward by a number of samples, fractions included."""
    whole, n = int(np.floor(samples)), series.size
    pad = abs(whole) + n
    long = np.pad(series, (pad, pad), mode="edge")
    if samples == whole:
        return long[pad + whole : pad + whole + n]
    size = long.size
    line = np.linspace(long[0], long[-1], size)  # the rest of it begins and ends alike
    spectrum = np.fft.rfft(long - line) * np.exp(2j * np.pi * np.fft.rfftfreq(size) * samples)
    moved = np.fft.irfft(spectrum, size) + line + samples * (long[-1] - long[0]) / (size - 1)
    return moved[pad : pad + n]
