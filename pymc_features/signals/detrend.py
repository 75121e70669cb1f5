"""Removing offsets and drifts of sensors."""

import numpy as np
import xarray as xr

from pymc_features._checks import check_choice
from pymc_features.signals.channels import check_window, rebuilt, sampling_step
from pymc_features.signals.gaps import filled

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
        of a short record is not its offset. The whole record by default.

    Returns
    -------
    xarray.DataArray
        Of the same shape. Of a channel with gaps, NaN, the samples that were measured count.

    Raises
    ------
    ValueError, TypeError
        If `kind` is unknown, the window does not lie within the record, or has fewer than two samples of a
        channel.

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
