"""Natural frequencies of the updated model beside those of the measurement."""

import numpy as np
import xarray as xr

from pymc_features._checks import check_group, message, shown
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.plots.drawing.axes import AxesLike, checked_axes


def plot_natural_frequencies(result: xr.DataTree, axes: AxesLike = None) -> np.ndarray:
    """Measured gain against frequency, and below it the 5-95 % intervals of every likelihood and mode.

    Dashed lines are frequencies given by the user, dotted ones the peaks of the measured gain.

    Parameters
    ----------
    result : DataTree
        From `run_update`: `data` with gain (sensor, frequency) [-] and peak_frequency, perhaps
        given_frequency [Hz]; natural_frequency (chain, draw, mode) [Hz] in `<likelihood>/modal`.
    axes : sequence of two matplotlib Axes, optional
        A new figure by default.

    Returns
    -------
    array of two matplotlib Axes
    """
    advice = "Pass what `run_update` returned."
    if not isinstance(result, xr.DataTree):
        raise TypeError(message("result", "a DataTree", shown(result), advice))
    kinds = [name for name, part in result.children.items() if "modal" in part.children]
    if not kinds:
        raise ValueError("`result` must have a likelihood with natural frequencies, got none.")
    data = check_group(result, "result", "data", advice, "sensor", "frequency")
    axes = checked_axes(
        axes,
        2,
        "parts (gain, frequencies)",
        figsize=(9.0, 3.2 + 0.35 * len(kinds)),
        sharex=True,
        height_ratios=[2.2, 0.5 + 0.35 * len(kinds)],
    )
    for sensor in data["sensor"].values:
        axes[0].plot(data["frequency"], data["gain"].sel(sensor=sensor), lw=1.0, label=str(sensor))
    axes[0].set(yscale="log", ylabel="gain against base [-]")
    top = 0.0
    for row, kind in enumerate(kinds):
        found = result[f"{kind}/modal"]["natural_frequency"]
        low, middle, high = found.quantile([0.05, 0.5, 0.95], dim=["chain", "draw"]).values
        colour = LIKELIHOODS[kind].colour
        axes[1].hlines(np.full(middle.size, row), low, high, color=colour, lw=5.0, alpha=0.4)
        axes[1].plot(middle, np.full(middle.size, row), "o", color=colour, ms=4)
        top = max(top, float(np.nanmax(high)))
    marks = [("peak_frequency", ":", "peaks of the gain"), ("given_frequency", "--", "given")]
    for name, style, label in marks:
        values = data[name].values if name in data else []
        for number, value in enumerate(values):
            for ax in axes:
                named = label if number == 0 and ax is axes[0] else None
                ax.axvline(value, color="0.4", ls=style, lw=0.9, zorder=0, label=named)
    axes[1].set_yticks(range(len(kinds)), kinds)
    axes[1].set(ylim=(len(kinds) - 0.5, -0.5), xlabel="frequency [Hz]")
    axes[1].set_xlim(0.0, min(1.3 * top, float(data["frequency"][-1])))
    seen = data["frequency"] <= axes[1].get_xlim()[1]
    largest = float(data["gain"].where(seen).max())
    axes[0].set_ylim(1e-3 * largest, 2.0 * largest)
    axes[0].legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return axes
