"""Posterior intervals of likelihood-free updating against the tolerance."""

import numpy as np
import xarray as xr

from pymc_features._checks import message, shown
from pymc_features.plots.drawing.axes import AxesLike, checked_axes

STATISTICS = ("log_probability", "log_probability_se", "simulations")


def plot_tolerance(result: xr.Dataset, axes: AxesLike = None) -> np.ndarray:
    """Median and interval of each scalar parameter against the tolerance.

    Parameters
    ----------
    result : Dataset
        From `tolerance_sweep`.
    axes : matplotlib Axes or sequence of them, optional
        One for each scalar parameter; a new figure by default.

    Returns
    -------
    array of matplotlib Axes
    """
    if not isinstance(result, xr.Dataset):
        raise TypeError(
            message("result", "a Dataset", shown(result), "Pass what tolerance_sweep() returned.")
        )
    names = [
        name
        for name, values in result.data_vars.items()
        if name not in STATISTICS and values.dims == ("epsilon", "quantile")
    ]
    if not names:
        raise ValueError("`result` must have a scalar parameter, got none. Select one entry of the vectors.")
    size = 4.5 * len(names), 3.4
    axes = checked_axes(axes, len(names), "scalar parameters", columns=len(names), figsize=size)
    for ax, name in zip(axes, names, strict=True):
        low, middle, high = result[name].transpose("quantile", "epsilon").values
        epsilon = result["epsilon"].values
        share = 100.0 * float(result["quantile"][2] - result["quantile"][0])
        ax.fill_between(epsilon, low, high, color="C4", alpha=0.3, lw=0, label=f"ABC, {share:g} %")
        ax.plot(epsilon, middle, "o-", color="C4", ms=3, lw=1.0, label="median")
        ax.set(xscale="log", xlabel="tolerance ε on ρ [squared units of the data]", ylabel=name)
        ax.legend(frameon=False)
    return axes
