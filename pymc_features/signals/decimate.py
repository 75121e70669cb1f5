"""A lower sampling rate without aliases."""

import numpy as np
import xarray as xr

from pymc_features._checks import check_integer
from pymc_features.signals.channels import check_array, rebuilt, sampling_step
from pymc_features.signals.gaps import filled, widened, without

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
        Positive.

    Returns
    -------
    xarray.DataArray
        Samples 0, factor, 2 factor, ... in time. Gaps, NaN, are wider by 20 new samples on each side, as far
        as the filter reaches.

    Raises
    ------
    ValueError, TypeError
        If `factor` is no positive integer, or the record is shorter than the filter.

    Notes
    -----
    A symmetric filter of 40 factor + 1 coefficients (Kaiser window), so without phase: within 1e-3 of 1 up to
    3/4 of half the new sampling rate, below 1e-3 from half the new rate on
    (tests/signals/test_signals.py). The
    straight line through first and last sample bypasses it; expect errors within 20 new samples of the ends.

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
    return rebuilt(channels, without(values, gaps), factor * step)
