"""Channels with the sign, gain or clock of single sensors put right."""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from pymc_features._checks import is_number, shown, single, to_float
from pymc_features.signals.channels import check_array, filled, rebuilt, sampling_step, widened, without
from pymc_features.signals.quasi_static import sensor_names

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
        Factor [-] for all sensors, or by name: -1 for an inverted one.
    delay : mapping of str to float, optional
        How late a sensor comes [s], by name, negative if early; any fraction of a sample. The channel is
        shifted back by as much.

    Returns
    -------
    xarray.DataArray (sensor, time)
        With the times of the input.

    Raises
    ------
    ValueError, TypeError
        If a name is no sensor, a factor is zero, or a delay is longer than a quarter of the record.

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
    factors = checked(dict.fromkeys(names, scale) if is_number(single(scale)) else scale, "scale", names)
    delays = checked(delay, "delay", names)
    values = channels.values.astype(np.float64)
    for name, factor in factors.items():
        if factor == 0.0:
            raise ValueError(f"`scale` must not be zero, got 0 for {name!r}. Leave the sensor out instead.")
        values[names.index(name)] *= factor
    for name, late in delays.items():
        most = 0.25 * step * values.shape[1]
        if abs(late) > most:
            raise ValueError(
                f"`delay` must be at most a quarter of the record, {most:.4g} s, got {late:g} s for "
                f"{name!r}. Cut the files to the same time instead."
            )
        values[names.index(name)] = with_gaps_earlier(values[names.index(name)], late / step)
    return rebuilt(channels, values, step, 0.0).assign_coords(time=channels["time"])


def checked(given, name, sensors) -> dict[str, float]:
    """Numbers by sensor."""
    if given is None:
        return {}
    values = {sensor: single(value) for sensor, value in given.items()} if isinstance(given, Mapping) else {}
    numbers = {sensor: to_float(value) for sensor, value in values.items() if is_number(value)}
    if (
        not isinstance(given, Mapping)
        or len(numbers) < len(given)
        or not np.isfinite([*numbers.values()]).all()
    ):
        raise TypeError(f"`{name}` must be a mapping of sensors to finite numbers, got {shown(given)}.")
    unknown = [sensor for sensor in given if sensor not in sensors]
    if unknown:
        raise ValueError(f"`{name}` must name sensors among {', '.join(sensors)}, got {unknown[0]!r}.")
    return numbers


def with_gaps_earlier(series, samples: float) -> np.ndarray:
    """A series (time,) shifted forward by a number of samples, gaps included."""
    whole, gaps = filled(series)
    moved = earlier(whole, samples)
    if not gaps.any():
        return moved
    nearest = round(samples)
    gaps = earlier(gaps.astype(np.float64), nearest) > 0.0
    return without(moved, gaps if nearest == samples else widened(gaps, _REACH))


def earlier(series, samples: float) -> np.ndarray:
    """A series (time,) shifted forward by a number of samples, a fraction included."""
    whole = int(np.floor(samples))
    rest, n = samples - whole, series.size
    pad = abs(whole) + n
    long = np.pad(series, (pad, pad), mode="edge")
    long = long[pad + whole : pad + whole + n] if rest == 0.0 else shifted(long, samples)[pad : pad + n]
    return long


def shifted(series, samples) -> np.ndarray:
    """Shift a series with constant ends by the Fourier transform."""
    n = series.size
    line = np.linspace(series[0], series[-1], n)  # the rest of it begins and ends alike
    spectrum = np.fft.rfft(series - line) * np.exp(2j * np.pi * np.fft.rfftfreq(n) * samples)
    return np.fft.irfft(spectrum, n) + line + samples * (series[-1] - series[0]) / (n - 1)
