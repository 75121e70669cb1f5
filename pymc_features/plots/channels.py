"""Measured channels below each other."""

import numpy as np
import xarray as xr

from pymc_features.plots.drawing.axes import AxesLike, checked_axes, set_title

HEIGHT, TALLEST = 0.9, 30.0  # inches, of a channel and of all


def plot_channels(channels: xr.DataArray, axes: AxesLike = None) -> np.ndarray:
    """Every channel against time, with its largest value, all on one scale.

    Parameters
    ----------
    channels : DataArray (sensor, time)
        Measured channels [m/s^2], with NaN in gaps.
    axes : sequence of matplotlib Axes, optional
        One for each sensor; a new figure by default.

    Returns
    -------
    array of matplotlib Axes
    """
    if not isinstance(channels, xr.DataArray) or channels.dims != ("sensor", "time"):
        raise TypeError(
            f"`channels` must be a DataArray (sensor, time), got {type(channels).__name__}. Read files with "
            "`read_channels`."
        )
    if not channels.size or channels.dtype.kind not in "iuf" or channels["time"].dtype.kind not in "iuf":
        raise ValueError(
            f"`channels` must hold numbers at times in seconds, got {channels.size} values of type "
            f"{channels.dtype} at times of type {channels['time'].dtype}."
        )
    n = channels.sizes["sensor"]
    figsize = (9.0, min(TALLEST, 0.8 + HEIGHT * n))
    axes = checked_axes(
        axes, n, "sensors", figsize=figsize, sharex=True, sharey="units" not in channels.coords
    )
    whole = [channels.attrs.get("units", "m/s^2")] * n
    units = channels["units"].values.tolist() if "units" in channels.coords else whole
    units = [unit.replace("^2", "²") for unit in units]
    for ax, name, values, unit in zip(axes, channels["sensor"].values, channels.values, units, strict=True):
        peak = int(np.nanargmax(np.abs(values)))
        ax.plot(channels["time"], values, color="0.25", lw=0.6)
        ax.plot(channels["time"][peak], values[peak], "o", color="C3", ms=4)
        set_title(ax, f"{name}, peak {abs(values[peak]):.3g} {unit}", loc="left", fontsize="medium")
    axes[-1].set(xlabel="time [s]", xlim=(float(channels["time"][0]), float(channels["time"][-1])))
    same = len(set(units)) == 1
    axes[n // 2].set_ylabel(f"{'acceleration ' if units[0] == 'm/s²' else ''}[{units[0]}]" if same else "")
    return axes
