"""Band-pass without phase."""

import numpy as np
import xarray as xr

from pymc_features._checks import check_integer
from pymc_features.signals.channels import check_frequency, rebuilt, sampling_step
from pymc_features.signals.gaps import filled, widened, without

HIGHEST = (
    10  # order; beyond it rounding moves the gain by per cents where a corner is a thousandth of the rate
)


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

    Raises
    ------
    ValueError, TypeError
        If no corner is given, they are out of order or range, or the record is too short for the filter.

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
    corners = [
        check_frequency(corner, name, nyquist)
        for name, corner in (("low", low), ("high", high))
        if corner is not None
    ]
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
        named = "low" if high is None or len(corners) == 2 else "high"
        raise ValueError(
            f"`{named}` must not be so far below the sampling rate, {1.0 / step:g} Hz, got {corners[0]:g} "
            "Hz: the filter cannot be computed. Subtract a line or an offset instead."
        ) from error
    gaps = widened(gaps, int(np.ceil(1.0 / (corners[0] * step))))
    return rebuilt(channels, without(filtered, gaps), step)
