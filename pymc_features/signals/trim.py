"""Cutting a window out of channels."""

import xarray as xr

from pymc_features.signals.channels import check_window, rebuilt, sampling_step


def trim(channels: xr.DataArray, start: float, stop: float) -> xr.DataArray:
    """Channels within a window of time, both ends included.

    Parameters
    ----------
    channels : xarray.DataArray (sensor, time) or (time,)
        Measured channels.
    start, stop : float
        First and last time kept [s], by the coordinate `time`.

    Returns
    -------
    xarray.DataArray (sensor, time) or (time,)
        With times from 0; `attrs["start"]` grows by what was cut at the front [s].

    Raises
    ------
    ValueError, TypeError
        If the window does not lie within the record or holds fewer than two samples.

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
