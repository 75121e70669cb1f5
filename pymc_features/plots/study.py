"""Figs. 2 to 6 of the study: posteriors, and their widths, against the sampling step."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from pymc_features._checks import check_group
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.plots.drawing.axes import (
    AxesLike,
    checked_axes,
    chosen_among,
    set_figure_title,
    set_title,
)

STUDY = "Pass what sampling_rate_study() returned."
LABELS = {
    "theta": "stiffness factor θ [-]",
    "sigma": "scale σ [m/s²]",
    "tau": "correlation time τ [s]",
}
MARKERS = dict(zip(LIKELIHOODS, "osD^vP<>X", strict=True))
ENTRY = 1.8  # inches, of a legend
DIMS = ("likelihood", "multiplier", "parameter")
APART = 0.09  # of neighbouring bars at one step, as a share of the step


def plot_sampling_rate(
    result: xr.DataTree,
    likelihoods: str | Sequence[str],
    axes: AxesLike = None,
    *,
    parameters: str | Sequence[str] = ("theta", "sigma"),
) -> np.ndarray:
    """Posteriors of some likelihoods at each sampling step, in the same axes for each parameter.

    Bars are the sampled 5-95 % intervals with the draw of the highest density; areas are the exact ones, and
    a dotted line the exact maximum, by quadrature.

    Parameters
    ----------
    result : DataTree
        From `sampling_rate_study`.
    likelihoods : str or sequence of str
        Which to draw; ("TN", "NORM") are Figs. 2 (theta) and 3 (sigma) of the source, ("EXP", "NORM", "ABC")
        Fig. 4. Those that have no sigma, or know it, appear for theta only.
    axes : sequence of matplotlib Axes, optional
        One for each parameter; a new figure by default.
    parameters : {"theta", "sigma", "tau"} or sequence of them
        Which to draw.

    Returns
    -------
    array of matplotlib Axes
    """
    summary = check_group(result, "result", "summary", STUDY, *DIMS)
    likelihoods = [] if likelihoods is None else likelihoods
    likelihoods = chosen_among(likelihoods, "likelihoods", summary["likelihood"].values.tolist())
    known = [name for name in LABELS if name in summary["parameter"]]
    parameters = chosen_among(parameters, "parameters", known)
    n = len(parameters)
    axes = checked_axes(axes, n, f"parameters {parameters}", columns=n, figsize=(2.5 + 3.6 * n, 4.0))
    for ax, parameter in zip(axes, parameters, strict=True):
        cells = summary.sel(parameter=parameter)
        known = cells["exact"].sel(statistic="q05").notnull().all("multiplier")
        drawn = [kind for kind in likelihoods if known.sel(likelihood=kind)]
        for i, kind in enumerate(drawn):
            draw_posteriors(ax, cells.sel(likelihood=kind), kind, 1.0 + APART * (i - (len(drawn) - 1) / 2))
        if parameter == "theta":
            ax.axhline(1.0, color="0.5", lw=0.8, ls="--", zorder=0, label="true value")
        ax.plot([], [], ":", color="0.3", lw=1.2, label="exact maximum")
        ax.fill_between([], [], color="0.3", alpha=0.2, lw=0, label="exact 5-95 %")
        label_steps(ax, summary["multiplier"].values, LABELS[parameter])
        ax.ticklabel_format(axis="y", useOffset=False)
    title = ", ".join(filter(None, [listed(likelihoods), result.attrs.get("title")]))
    set_figure_title(axes[0].figure, title)
    handles, labels = axes[0].get_legend_handles_labels()
    rows = int(np.ceil(ENTRY * len(labels) / axes[0].figure.get_figwidth()))
    columns = -(-len(labels) // rows)
    axes[0].figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
    return axes


def draw_posteriors(ax, cell, kind, shift) -> None:
    """One likelihood and parameter: exact areas and lines, sampled bars beside each other."""
    steps, colour = cell["multiplier"].values, LIKELIHOODS[kind].colour
    exact, sampled = (cell[name].transpose("statistic", "multiplier").values for name in ("exact", "sampled"))
    ax.fill_between(steps, exact[1], exact[3], color=colour, alpha=0.2, lw=0)
    ax.plot(steps, exact[0], ":", color=colour, lw=1.2)
    best, low, _, high = sampled
    middle = np.clip(best, low, high)  # of a narrow interval the draw of the highest density may lie outside
    bars = {"yerr": [middle - low, high - middle], "capsize": 3, "lw": 1.5, "zorder": 3}
    ax.errorbar(steps * shift, middle, fmt="none", ecolor=colour, **bars)
    ax.plot(steps * shift, best, MARKERS[kind], color=colour, ms=4.5, label=f"{kind}, sampled")


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
    summary = check_group(result, "result", "summary", STUDY, *DIMS)
    summary = summary.sel(parameter="theta")
    [ax] = axes = checked_axes(axes, figsize=(7.5, 4.2))
    width = summary.sel(statistic="q95") - summary.sel(statistic="q05")
    steps = summary["multiplier"].values
    for kind in map(str, summary["likelihood"].values):
        colour, cell = LIKELIHOODS[kind].colour, width.sel(likelihood=kind)
        dashes = "--" if kind.startswith("CN") else "-"  # CN-TAU lies on NORM
        ax.plot(steps, cell["exact"], dashes, color=colour, lw=1.5, label=kind)
        ax.plot(steps, cell["sampled"], MARKERS[kind], color=colour, ms=4.5)
    label_steps(ax, steps, "5-95 % width of θ [-]")
    ax.set_yscale("log")
    set_title(ax, result.attrs.get("title", ""))
    ax.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return axes


def label_steps(ax, steps, label: str) -> None:
    """Sampling steps on the horizontal axis, each with its number."""
    ax.set(xscale="log", xlabel="sampling step / record step [-]", ylabel=label)
    ax.set_xticks(steps, [f"{step:g}" for step in steps])
    ax.minorticks_off()


def listed(names: Sequence[str]) -> str:
    """Names in a sentence."""
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
