"""Posterior intervals of likelihood-free updating against the tolerance."""

import matplotlib.pyplot as plt
import numpy as np

STATISTICS = ("log_probability", "log_probability_se", "simulations")


def plot_tolerance(result, ax=None):
    """Median and interval of each scalar parameter against the tolerance.

    Parameters
    ----------
    result : Dataset
        From `tolerance_sweep`.
    ax : matplotlib Axes or sequence of them, optional
        One for each scalar parameter; a new figure by default.

    Returns
    -------
    list of matplotlib Axes
    """
    names = [
        name
        for name, values in result.data_vars.items()
        if name not in STATISTICS and values.dims == ("epsilon", "quantile")
    ]
    if not names:
        raise ValueError("`result` must have a scalar parameter, got none. Select one entry of the vectors.")
    if ax is None:
        _, axes = plt.subplots(
            1, len(names), figsize=(4.5 * len(names), 3.4), layout="constrained", squeeze=False
        )
        ax = axes[0]
    ax = np.atleast_1d(ax)
    if len(ax) != len(names):
        raise ValueError(f"`ax` must be one for each of {', '.join(map(str, names))}, got {len(ax)}.")
    for axis, name in zip(ax, names, strict=True):
        low, middle, high = result[name].transpose("quantile", "epsilon").values
        tolerance = result["epsilon"].values
        share = 100.0 * float(result["quantile"][2] - result["quantile"][0])
        axis.fill_between(tolerance, low, high, color="C4", alpha=0.3, lw=0, label=f"ABC, {share:g} %")
        axis.plot(tolerance, middle, "o-", color="C4", ms=3, lw=1.0, label="median")
        axis.set(xscale="log", xlabel="tolerance δ on ρ [squared units of the data]", ylabel=name)
        axis.legend(frameon=False)
    return list(ax)
