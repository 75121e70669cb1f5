"""Figs. 2-4: maximum and 5-95 % interval of theta and sigma against the sampling step."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from pymc_features._checks import check_group
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.plots.drawing.axes import AxesLike, checked_axes, chosen_among, set_figure_title

STUDY = "Pass what sampling_rate_study() returned."
LABELS = {
    "theta": "stiffness factor θ [-]",
    "sigma": "scale σ [m/s²]",
}


def plot_sampling_rate(
    result: xr.DataTree, likelihoods: str | Sequence[str], axes: AxesLike = None
) -> np.ndarray:
    """Posterior of theta and sigma at each sampling step, sampled and exact.

    Bars are the sampled 5-95 % intervals with the draw of the highest density; lines are the exact
    quantiles, and a dotted line the exact maximum, by quadrature.

    Parameters
    ----------
    result : DataTree
        From `sampling_rate_study`.
    likelihoods : str or sequence of str
        Which to draw; "NORM" is Fig. 2 of the source, "TN" Fig. 3, ("EXP", "ABC") Fig. 4. Those that have no
        sigma, or know it, appear for theta only.
    axes : sequence of two matplotlib Axes, optional
        For theta and sigma; a new figure by default.

    Returns
    -------
    array of two matplotlib Axes
    """
    summary = check_group(result, "result", "summary", STUDY, "likelihood", "multiplier")
    likelihoods = [] if likelihoods is None else likelihoods
    likelihoods = chosen_among(likelihoods, "likelihoods", summary["likelihood"].values.tolist())
    axes = checked_axes(axes, 2, "parameters (theta, sigma)", columns=2, figsize=(9.0, 3.6))
    for ax, parameter in zip(axes, LABELS, strict=True):
        known = summary["exact"].sel(parameter=parameter, statistic="q05").notnull().all("multiplier")
        drawn = [k for k in likelihoods if known.sel(likelihood=k)]
        for i, kind in enumerate(drawn):
            shift = 1.0 + 0.07 * (2 * i - len(drawn) + 1)
            _draw(ax, summary.sel(likelihood=kind, parameter=parameter), kind, shift)
        if parameter == "theta":
            ax.axhline(1.0, color="0.5", lw=0.8, ls="--", zorder=0, label="true value")
        multipliers = summary["multiplier"].values
        ax.set_xscale("log")
        ax.set_xticks(multipliers, [f"{m:g}" for m in multipliers])
        ax.minorticks_off()
        ax.ticklabel_format(axis="y", useOffset=False)
        ax.set(xlabel="sampling step / record step [-]", ylabel=LABELS[parameter])
    figure = axes[0].figure
    title = ", ".join(filter(None, [" and ".join(likelihoods), result.attrs.get("title")]))
    set_figure_title(figure, title)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return axes


def _draw(ax, cell, kind, shift):
    """One likelihood and parameter: exact lines, sampled bars."""
    steps = cell["multiplier"].values
    colour = LIKELIHOODS[kind].colour
    exact = cell["exact"].transpose("statistic", "multiplier").values
    sampled = cell["sampled"].transpose("statistic", "multiplier").values
    ax.fill_between(steps, exact[1], exact[3], color=colour, alpha=0.15, lw=0)
    ax.plot(steps, exact[0], ":", color=colour, lw=1.0)
    label = f"{kind}: sampled, shaded exact"
    middle = np.clip(sampled[0], sampled[1], sampled[3])
    errors = np.stack([middle - sampled[1], sampled[3] - middle])
    ax.errorbar(
        steps * shift,
        middle,
        yerr=errors,
        fmt="none",
        ecolor=colour,
        capsize=3,
        lw=1.2,
        label=label,
    )
    ax.plot(steps * shift, sampled[0], "o", color=colour, ms=4)
