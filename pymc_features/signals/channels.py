"""What an array of channels is: sensors on one even clock, NaN where a sensor has a gap of its own."""

import numpy as np
import xarray as xr

from pymc_features._checks import check_finite, check_number, is_number, message, shown, single, warn_caller
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
        name = str(sensor_names(channels)[silent[0]])
        raise ValueError(
            f"`channels` must have samples of every sensor, got NaN alone in {name!r}. Leave it out."
        )
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
    """Sampling interval [s] of channels, from their time coordinate.

    Raises
    ------
    ValueError, TypeError
        If the array is none of channels, has no time coordinate, or its steps are uneven by more than a
        thousandth.
    """
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
    return xr.DataArray(
        values, dims=channels.dims, coords=coords | {"time": time}, name=channels.name, attrs=attrs
    )


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
        raise ValueError(
            f"`{name}` must hold at least 2 samples, got ({first:g}, {last:g}) at a step of {step:g} s."
        )
    return low, high


def check_frequency(value, name: str, nyquist: float) -> float:
    """A frequency [Hz] between 0 and half the sampling rate."""
    frequency = check_number(value, name, "Pass a frequency in Hz.")
    if not 0.0 < frequency < nyquist:
        raise ValueError(
            f"`{name}` must lie between 0 and {nyquist:g} Hz, half the sampling rate, got {frequency:g}."
        )
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
    try:
        first, last = pair
    except Exception:  # anything may fail to be two, in its own way
        first = last = None
    if not (is_number(single(first)) and is_number(single(last))):
        raise TypeError(message(name, what, shown(pair)))
    return check_number(first, name), check_number(last, name)


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
