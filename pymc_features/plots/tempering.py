"""The way of a sampler from the prior to the posterior."""

import numpy as np
import xarray as xr

from pymc_features._checks import message, shown
from pymc_features.plots.drawing.axes import AxesLike, checked_axes


def plot_tempering(idata: xr.DataTree, axes: AxesLike = None) -> np.ndarray:
    """Inverse temperature, or tolerance of ABC, and acceptance rate at each stage, one line for each chain.

    Parameters
    ----------
    idata : DataTree
        From `sample_smc`: `sample_stats` with beta or epsilon (chain, stage).
    axes : sequence of two matplotlib Axes, optional
        A new figure by default.

    Returns
    -------
    array of two matplotlib Axes
    """
    if not isinstance(idata, xr.DataTree):
        raise TypeError(message("idata", "a DataTree", shown(idata), "Pass what sample_smc() returned."))
    stats = idata["sample_stats"].to_dataset() if "sample_stats" in idata.children else {}
    name = next((n for n in ("epsilon", "beta") if n in stats and "stage" in stats[n].dims), None)
    if name is None:
        raise ValueError(
            "`idata` must be of a sampler with stages, got none in `sample_stats`. Pass what sample_smc() "
            "returned."
        )
    axes = checked_axes(axes, 2, "parts (temperature, acceptance)", columns=2, figsize=(9.0, 3.2))
    labels = {
        "beta": "inverse temperature β [-]",
        "epsilon": "tolerance ε [(unit of the data)²]",
    }
    for ax, part, label in ((axes[0], name, labels[name]), (axes[1], "accept_rate", "acceptance rate [-]")):
        if part in stats:
            for chain, values in zip(stats["chain"].values, stats[part].values, strict=True):
                stage = 1 + np.arange(values.size)
                ax.plot(
                    stage, np.where(values > 0, values, np.nan), "o-", ms=3, lw=1.0, label=f"chain {chain}"
                )
        ax.set(xlabel="stage", ylabel=label)
        ax.xaxis.get_major_locator().set_params(integer=True)
    axes[0].set_yscale("log")
    axes[1].set_ylim(0.0, 1.0)
    axes[0].legend(frameon=False)
    return axes
