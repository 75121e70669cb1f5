"""Width of the posterior of theta against the sampling step, for every likelihood."""

import numpy as np
import xarray as xr

from pymc_features._checks import check_group
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.plots.drawing.axes import AxesLike, checked_axes, set_title

STUDY = "Pass what sampling_rate_study() returned."


def plot_widths(result: xr.DataTree, axes: AxesLike = None) -> np.ndarray:
    """5-95 % width of theta at each sampling step: what a faster sampling does to the uncertainty.

    Lines are exact, by quadrature; markers are sampled.

    Parameters
    ----------
    result : DataTree
        From `sampling_rate_study`.
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    array of one matplotlib Axes
    """
    summary = check_group(result, "result", "summary", STUDY, "likelihood", "multiplier", "parameter")
    summary = summary.sel(parameter="theta")
    axes = checked_axes(axes, figsize=(7.5, 4.2))
    ax = axes[0]
    width = summary.sel(statistic="q95") - summary.sel(statistic="q05")
    steps = summary["multiplier"].values
    for kind in summary["likelihood"].values:
        colour, cell = LIKELIHOODS[str(kind)].colour, width.sel(likelihood=kind)
        dashes = "--" if str(kind).startswith("CN") else "-"  # CN-TAU lies on NORM
        ax.plot(steps, cell["exact"], dashes, color=colour, lw=1.5, label=str(kind))
        ax.plot(steps, cell["sampled"], "o", color=colour, ms=4)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xticks(steps, [f"{m:g}" for m in steps])
    ax.minorticks_off()
    ax.set(xlabel="sampling step / record step [-]", ylabel="5-95 % width of θ [-]")
    set_title(ax, result.attrs.get("title", ""))
    ax.legend(frameon=False, ncols=1, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return axes
