"""Parameters from event to event, and when a structure has changed."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from pymc_features._checks import check_group
from pymc_features.plots.drawing.axes import AxesLike, checked_axes, chosen_among

NAMED = 12  # events with room for their names
WIDE = 1.645  # standard deviations of 90 %


def plot_sequence(
    idata: xr.DataTree, parameters: Sequence[str] | None = None, axes: AxesLike = None
) -> np.ndarray:
    """Mean and 90 % band of each parameter after each event, with the events that raised an alarm.

    Parameters
    ----------
    idata : DataTree
        From `continue_with` or `sample_in_sequence`; a coordinate `name` (event) of `sequence` names a few
        events.
    parameters : sequence of str, optional
        Which to draw; all by default.
    axes : sequence of matplotlib Axes, optional
        One for each parameter; a new figure by default.

    Returns
    -------
    array of matplotlib Axes
    """
    from matplotlib.ticker import MaxNLocator

    record = check_group(
        idata, "idata", "sequence", "Pass what continue_with() returned.", "event", "parameter"
    )
    names = chosen_among(parameters, "parameters", [str(name) for name in record["parameter"].values])
    axes = checked_axes(axes, len(names), "parameters", columns=1, figsize=(7.5, 0.6 + 1.8 * len(names)))
    event = record["event"].values
    for ax, name in zip(axes, names, strict=True):
        one = record.sel(parameter=name)
        mean, half = one["mean"].values, WIDE * one["standard_deviation"].values
        ax.fill_between(event, mean - half, mean + half, color="C0", alpha=0.25, lw=0, label="90 %")
        ax.plot(event, mean, "o-", color="C0", ms=3, lw=1.0, label="mean")
        for i, at in enumerate(event[record["alarm"].values > 0]):
            ax.axvline(at, color="C3", lw=1.2, ls="--", label=None if i else "alarm")
        ax.set(xlabel="event", ylabel=name)
        ax.legend(frameon=False, fontsize="small")
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    if "name" in record.coords and event.size <= NAMED:
        for ax in axes:
            ax.set(xlabel="", xticks=event, xticklabels=[])
        axes[-1].set_xticklabels(record["name"].values.astype(str), rotation=20, ha="right")
    return axes
