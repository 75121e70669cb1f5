"""Channels on one even clock, NaN in gaps: their rules, and cuts, filters, rates and corrections of them."""

from collections.abc import Mapping
from functools import partial

import numpy as np
import xarray as xr

from pymc_features import _checks as checks
from pymc_features._checks import require
from pymc_features.exceptions import ChannelWarning

#: Warn at the line that called into this package from outside.
warn_channel = partial(checks.warn_caller, category=ChannelWarning)
HIGHEST = 10  # order of a filter; beyond, rounding moves gains by per cents at corners of 1/1000 of the rate
_HALF_LENGTH = 20  # of the filter of `decimate`, in samples of the result
_KAISER = 7.86  # 80 dB in the stop band, over a transition of a quarter of half the new rate
_CORNER = 0.875  # middle of the transition, of half the new rate
_REACH = 10  # samples of a shift by a part of one


def check_array(channels, sensors: bool = False, name: str = "channels") -> xr.DataArray:
    """Channels as they came, if an array (sensor, time), or (time,) if not `sensors`, of numbers and NaN."""
    if not isinstance(channels, xr.DataArray):
        what, got = "an xarray.DataArray (sensor, time)", type(channels).__name__
        raise TypeError(checks.message(name, what, got, "Read files with `read_channels`."))
    allowed = [("sensor", "time")] if sensors else [("sensor", "time"), ("time",)]
    what = f"have dimensions {' or '.join(map(str, allowed))}, got {channels.dims}"
    require(channels.dims in allowed, f"`{name}` must {what}. Transpose or rename them: time is the last.")
    if channels.dtype.kind not in "iuf":
        raise TypeError(f"`{name}` must hold numbers, got {channels.dtype}.")
    require(channels.size, f"`{name}` must hold samples, got shape {channels.shape}.")
    gaps = np.isnan(channels.values)
    checks.check_finite(np.where(gaps, 0.0, channels.values), name, "NaN is a gap.")
    if (silent := np.flatnonzero(gaps.all(axis=-1))).size:
        got = f"NaN alone in {str(sensor_names(channels)[silent[0]])!r}"
        raise ValueError(f"`{name}` must have samples of every sensor, got {got}. Leave it out.")
    names = [str(sensor) for sensor in channels["sensor"].values] if sensors else []
    what = f"a name of its own for each sensor, got {', '.join(names)}"
    require(len(set(names)) == len(names), f"`{name}` must have {what}.")
    return channels


def sensor_names(channels: xr.DataArray) -> list:
    """Labels of the sensors, counted where they have none."""
    return list(np.ravel(channels["sensor"])) if "sensor" in {*channels.dims, *channels.coords} else [0]


def whole_values(channels) -> np.ndarray:
    """Numbers (sensor, time) of channels; refuse those with gaps."""
    values = check_array(channels, sensors=True).values.astype(np.float64)
    checks.check_finite(values, "channels", "Cut the record where there are gaps.")
    return values


def sampling_step(channels: xr.DataArray) -> float:
    """Sampling interval [s] of channels, from their time coordinate, even to a thousandth."""
    return step_of(check_array(channels), "channels")


def step_of(channels: xr.DataArray, name: str) -> float:
    """Sampling interval [s] of an array (..., time), which a message calls by a name."""
    got = f"{channels.sizes['time']} samples and coordinates {list(channels.coords)}"
    is_there = "time" in channels.coords and channels.sizes["time"] > 1
    require(is_there, f"`{name}` must have a time coordinate [s] of at least 2 samples, got {got}.")
    time = channels["time"].values
    if time.dtype.kind not in "iuf":
        got = f"a time coordinate of type {time.dtype}. Pass seconds from the first sample"
        raise TypeError(f"`{name}` must have times in seconds, got {got}.")
    time = time.astype(np.float64)
    step = (time[-1] - time[0]) / (time.size - 1)
    uneven = np.abs(time - time[0] - step * np.arange(time.size))
    vary = f"their steps vary from {np.diff(time).min():.4g} s to {np.diff(time).max():.4g} s"
    is_even = step > 0.0 and uneven.max() <= 1e-3 * step
    require(is_even, f"`{name}` must be evenly sampled, {vary}. Resample them first.")
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
    inside = begin - slack <= first < last <= end + slack
    what = f"within the record, {begin:g} s to {end:g} s, and run forward, got ({first:g}, {last:g})"
    require(inside, f"`{name}` must lie {what}. Times are those of the coordinate `time`.")
    low = int(np.ceil((first - begin) / step - 1e-6))
    high = int(np.floor((last - begin) / step + 1e-6)) + 1
    got = f"({first:g}, {last:g}) at a step of {step:g} s"
    require(high - low > 1, f"`{name}` must hold at least 2 samples, got {got}.")
    return low, high


def check_frequency(value, name: str, nyquist: float) -> float:
    """A frequency [Hz] between 0 and half the sampling rate."""
    frequency = checks.check_number(value, name, "Pass a frequency in Hz.")
    what = f"between 0 and {nyquist:g} Hz, half the sampling rate, got {frequency:g}"
    require(0.0 < frequency < nyquist, f"`{name}` must lie {what}.")
    return frequency


def check_band(band, step: float) -> tuple[float, float]:
    """Two rising frequencies [Hz] below half the sampling rate."""
    edges = check_pair(band, "band", "two frequencies (from, to) in Hz")
    low, high = (check_frequency(edge, "band", 0.5 / step) for edge in edges)
    require(low < high, f"`band` must rise, got ({low:g}, {high:g}) Hz.")
    return low, high


def check_pair(pair, name: str, what: str) -> tuple[float, float]:
    """Two numbers."""
    numbers = [checks.single(number) for number in checks.as_list(pair) or []]
    if len(numbers) != 2 or not all(map(checks.is_number, numbers)):
        raise TypeError(checks.message(name, what, checks.shown(pair)))
    return checks.to_float(numbers[0]), checks.to_float(numbers[1])


def filled(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (..., time) with lines across gaps, constant at the ends, and where these are, (..., time)."""
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
    if not gaps.any():
        return gaps
    from scipy.ndimage import maximum_filter1d  # slow to import

    return maximum_filter1d(gaps, 2 * samples + 1, mode="constant")


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
    >>> ramp = xr.DataArray([0.0, 1.0, 2.0, 3.0], {"time": [0.0, 0.1, 0.2, 0.3]})
    >>> trim(ramp, 0.1, 0.2).values
    array([1., 2.])
    """
    low, high = check_window(channels, (start, stop), "start, stop")
    step = sampling_step(channels)
    return rebuilt(channels, channels.values[..., low:high].copy(), step, low * step)


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
        (from, to) [s] to take offset or line from, such as the quiet time before the shaking; two samples of
        each channel at least. The whole by default, whose mean is not the offset of a short record.

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
    checks.check_choice(kind, "kind", ("constant", "linear"))
    step, values = sampling_step(channels), channels.values.astype(np.float64)
    low, high = (0, channels.sizes["time"]) if window is None else check_window(channels, window)
    for i, history in enumerate(np.atleast_2d(values)):
        known = low + np.flatnonzero(~np.isnan(history[low:high]))
        got = f"{known.size} of channel {i}, which has a gap there. Choose another"
        require(known.size > 1, f"`window` must hold at least 2 samples of every channel, got {got}.")
        fit = np.polynomial.Polynomial.fit(known, history[known], int(kind == "linear"))
        history -= fit(np.arange(history.size))
    return rebuilt(channels, values, step)


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
        1 to 10. Both runs together have the gain 1 / (1 + (f / high)^(2 order)) of a low-pass, so 1/2 at the
        corner.

    Returns
    -------
    xarray.DataArray
        Of the same shape; nothing is shifted in time. Gaps, NaN, were straight lines to the filter, and are
        wider by one period of the lowest corner on each side.

    Notes
    -----
    By `scipy.signal.sosfiltfilt`; expect errors at the ends for about one period of the lower corner. Filter
    excitation and response alike: a linear structure then has the same transfer function between them. A
    high-pass also removes the static offset.
    """
    from scipy import signal  # a second to import

    step = sampling_step(channels)
    named = {name: corner for name, corner in (("low", low), ("high", high)) if corner is not None}
    require(named, "`low` or `high` must be given, got neither. Pass corner frequencies in Hz.")
    corners = [check_frequency(corner, name, 0.5 / step) for name, corner in named.items()]
    if len(corners) == 2 and not corners[0] < corners[1]:
        raise ValueError(f"`low` must be below `high`, got {corners[0]:g} and {corners[1]:g} Hz.")
    order = checks.check_integer(order, "order", most=HIGHEST)
    kind = "bandpass" if len(corners) == 2 else "lowpass" if low is None else "highpass"
    sections = signal.butter(order, np.squeeze(corners), kind, output="sos", fs=1.0 / step)
    shortest, n_times = 3 * (2 * len(sections) + 1), channels.sizes["time"]
    what = f"more than {shortest} samples for this filter, got {n_times}"
    require(n_times > shortest, f"`channels` must have {what}. Lower `order`, or filter before trimming.")
    try:
        values, gaps = filled(channels.values.astype(float))
        filtered = signal.sosfiltfilt(sections, values)
    except ValueError as error:  # a pole at 1, to rounding
        what = f"so far below the sampling rate, {1.0 / step:g} Hz, got {corners[0]:g} Hz"
        said = "the filter cannot be computed. Subtract a line or an offset instead."
        raise ValueError(f"`{next(iter(named))}` must not be {what}: {said}") from error
    gaps = widened(gaps, int(np.ceil(1.0 / (corners[0] * step))))
    return rebuilt(channels, np.where(gaps, np.nan, filtered), step)


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
    The line through first and last sample bypasses it; expect errors within 20 new samples of the ends.

    Decimate measured floors as far as you like, but not the base: `response(..., dt=)` has a step of its own,
    and modes above half the new rate are not excited by a base that was decimated.
    """
    from scipy import signal  # a second to import

    factor = checks.check_integer(factor, "factor", advice="2 halves the sampling rate.")
    step = sampling_step(check_array(channels))
    values, gaps = filled(channels.values.astype(np.float64))
    if factor > 1:
        length = 2 * _HALF_LENGTH * factor + 1
        what = f"at least {length} samples to be decimated by {factor}, got {values.shape[-1]}"
        require(values.shape[-1] >= length, f"`channels` must have {what}. Decimate before trimming.")
        window = signal.firwin(length, _CORNER / factor, window=("kaiser", _KAISER))
        values = signal.resample_poly(values, 1, factor, axis=-1, window=window, padtype="line")
        gaps = widened(gaps, _HALF_LENGTH * factor)[..., ::factor]
    return rebuilt(channels, np.where(gaps, np.nan, values), factor * step)


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
    transform). Beyond an end of the record there is the value of that end. Gaps, NaN, are shifted too, and by
    part of a sample wider by ten samples on each side.

    Examples
    --------
    >>> coords = {"sensor": ["base", "roof"], "time": [0.0, 0.5, 1.0, 1.5]}
    >>> channels = xr.DataArray([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, -2.0, 0.0]], coords)
    >>> correct(channels, scale={"roof": -0.5}, delay={"roof": 0.5}).values[1].round(12) + 0.0
    array([0., 1., 0., 0.])
    """
    names, step = list(map(str, sensor_names(check_array(channels, sensors=True)))), sampling_step(channels)
    values, most = channels.values.astype(np.float64), 0.25 * step * channels.sizes["time"]
    scale = checks.single(scale)
    scale = dict.fromkeys(names, scale) if checks.is_number(scale) else scale
    for name, factor in _by_sensor(scale, "scale", names).items():
        require(factor, f"`scale` must not be zero, got 0 for {name!r}. Leave the sensor out instead.")
        values[names.index(name)] *= factor
    for name, late in _by_sensor(delay, "delay", names).items():
        what = f"at most a quarter of the record, {most:.4g} s, got {late:g} s for {name!r}"
        require(abs(late) <= most, f"`delay` must be {what}. Cut the files to the same time instead.")
        samples, nearest = late / step, round(late / step)
        whole, gaps = filled(values[names.index(name)])
        moved = earlier(whole, samples)
        if gaps.any():
            gaps = earlier(gaps.astype(np.float64), nearest) > 0.0
            moved[gaps if nearest == samples else widened(gaps, _REACH)] = np.nan
        values[names.index(name)] = moved
    return rebuilt(channels, values, step, 0.0).assign_coords(time=channels["time"])


def _by_sensor(mapping, name, sensors) -> dict[str, float]:
    """Numbers by sensor; none of None."""
    mapping = {} if mapping is None else mapping
    values = [checks.single(value) for value in mapping.values()] if isinstance(mapping, Mapping) else [None]
    if not all(checks.is_number(value) and np.isfinite(checks.to_float(value)) for value in values):
        what = f"a mapping of sensors to finite numbers, got {checks.shown(mapping)}"
        raise TypeError(f"`{name}` must be {what}.")
    numbers = dict(zip(mapping, map(checks.to_float, values), strict=True))
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
