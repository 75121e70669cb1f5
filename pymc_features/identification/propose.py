"""Bands around the peaks of the singular values of the spectra."""

import numpy as np
import xarray as xr

from pymc_features._checks import check_positive, message
from pymc_features.signals import sampling_step
from pymc_features.signals.channels import whole_values
from pymc_features.signals.spectra import averaged_spectra

PROMINENCE = 6.0  # dB above the valleys beside a peak
HALF_WIDTH = 0.06  # of a band, relative to the frequency of its peak
FEWEST = 3.0  # resolutions of the averaged spectrum on each side


def propose_bands(channels: xr.DataArray, *, highest: float | None = None) -> np.ndarray:
    """Bands around the peaks of the first singular value of the spectra, to begin with.

    Spectra are averaged over twenty parts of the record (Welch); a peak stands 6 dB above the valleys on both
    of its sides. The lowest band does not begin below the valley beside a drift. Look at the bands in the
    spectra: a machine is a peak as well.

    Parameters
    ----------
    channels : DataArray (sensor, time)
        As `read_channels` returns them.
    highest : float, optional
        Frequency [Hz] up to which to look; 0.4 of the sampling rate by default.

    Returns
    -------
    array (band, 2)
        Lower and upper ends [Hz], apart from each other.

    Raises
    ------
    ValueError
        If there is no peak.
    """
    from scipy import signal  # a second to import

    values, dt = whole_values(channels), sampling_step(channels)
    highest = 0.4 / dt if highest is None else check_positive(highest, "highest", "Pass it in Hz.")
    spectra = averaged_spectra(values, dt)
    f, first = spectra.frequencies, spectra.singular_values[:, 0]
    inside = (f > 0.0) & (f <= highest)
    f, level = f[inside], 10.0 * np.log10(np.maximum(first[inside], np.finfo(float).tiny))
    peaks, _ = signal.find_peaks(level, prominence=PROMINENCE)
    if not peaks.size:
        raise ValueError(
            message(
                "channels",
                "of a structure that moves in its modes",
                "spectra without a peak",
                "Pass `bands`.",
            )
        )
    half = np.maximum(HALF_WIDTH * f[peaks], FEWEST * (f[1] - f[0]))
    bands = np.column_stack([np.maximum(f[peaks] - half, 0.5 * f[0]), np.minimum(f[peaks] + half, 0.49 / dt)])
    valley = int(level[: peaks[0]].argmin())
    if np.interp(bands[0, 0], f, level) > level[valley] + PROMINENCE:  # in the drift
        bands[0, 0] = f[valley]
    joined = [bands[0]]
    for low, high in bands[1:]:
        if low <= joined[-1][1]:
            joined[-1] = np.array([joined[-1][0], high])
        else:
            joined.append(np.array([low, high]))
    return np.array(joined)
