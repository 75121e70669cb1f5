"""What an array of channels is: sensors on one even clock, NaN where a sensor has a gap."""

import os
import warnings

import numpy as np
import xarray as xr

from pymc_features._checks import check_finite, is_number
from pymc_features.exceptions import ChannelWarning

_PACKAGE = os.path.dirname(os.path.dirname(__file__))


def warn_channel(message: str) -> None:
    """Warn at the line that called into this package from outside."""
    warnings.warn(message, ChannelWarning, skip_file_prefixes=(_PACKAGE,))


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
    gaps = np.isnan(channels.values)
    check_finite(np.where(gaps, 0.0, channels.values), "channels", "NaN is a gap.")
    silent = np.flatnonzero(gaps.all(axis=-1)) if channels.sizes["time"] else []
    if len(silent):
        known = "sensor" in channels.coords
        name = str(np.ravel(channels.coords["sensor"])[silent[0]] if known else silent[0])
        raise ValueError(
            f"`channels` must have samples of every sensor, got NaN alone in {name!r}. Leave it out."
        )
    return channels


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
    """The same sensors with other values (..., time): time from 0, `start` [s] later than it was."""
    coords = {name: c for name, c in channels.coords.items() if "time" not in c.dims}
    attrs = channels.attrs | {"start": float(channels.attrs.get("start", 0.0)) + start}
    time = ("time", step * np.arange(values.shape[-1]), {"units": "s"})
    return xr.DataArray(
        values, dims=channels.dims, coords=coords | {"time": time}, name=channels.name, attrs=attrs
    )


def check_window(channels: xr.DataArray, window, name: str = "window") -> tuple[int, int]:
    """First and one past the last sample of a window (from, to) [s], both ends included."""
    step = sampling_step(channels)
    try:
        first, last = (float(edge) for edge in window)
    except (TypeError, ValueError):
        raise TypeError(f"`{name}` must be two times (from, to) in seconds, got {window!r}.") from None
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
    if not is_number(value):
        raise TypeError(f"`{name}` must be a frequency in Hz, got {value!r}.")
    if not 0.0 < value < nyquist:
        raise ValueError(
            f"`{name}` must lie between 0 and {nyquist:g} Hz, half the sampling rate, got {value:g}."
        )
    return float(value)
