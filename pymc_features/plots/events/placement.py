"""Where sensors are to be, along the structure."""

import numpy as np
import xarray as xr

from pymc_features._checks import message, shown
from pymc_features.plots.drawing.axes import AxesLike, checked_axes

UNITS = {
    "D": "information [nats]",
    "A": "share of the prior variance [-]",
    "prediction": "share of the response's variance [-]",
}


def plot_sensor_placement(result: xr.Dataset, axes: AxesLike = None) -> np.ndarray:
    """What each candidate tells by itself, the chosen ones in their order, and what they tell together.

    Parameters
    ----------
    result : Dataset
        From `sensor_placement`.
    axes : sequence of two matplotlib Axes, optional
        A new figure by default.

    Returns
    -------
    array of two matplotlib Axes
    """
    if not isinstance(result, xr.Dataset) or not {"alone", "gain", "sensor"} <= set(result.data_vars):
        raise TypeError(
            message("result", "a Dataset", shown(result), "Pass what sensor_placement() returned.")
        )
    axes = checked_axes(axes, 2, "places and numbers of sensors", columns=2, figsize=(8.5, 4.0))
    along, together = axes
    names, alone = list(result["candidate"].values), result["alone"].values
    unit = UNITS[result.attrs["criterion"]]
    height = np.arange(len(names))
    along.barh(height, alone, color="0.85")
    for order, name in zip(result["order"].values, result["sensor"].values, strict=True):
        at = names.index(name)
        along.barh(at, alone[at], color="C0")
        along.annotate(str(order), (alone[at], at), xytext=(3, 0), textcoords="offset points", va="center")
    along.set_yticks(height, [str(name) for name in names])
    along.set(xlabel=f"{unit}, alone", ylabel="place")
    together.plot(result["order"], result["gain"], "o-", color="C0")
    together.set(xlabel="sensors", ylabel=f"{unit}, together", ylim=(0.0, None))
    together.set_xticks(result["order"].values)
    return axes
