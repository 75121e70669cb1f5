"""Results against what was changed or counted: sampling step, tolerance, stage, event, number of sensors."""

from collections.abc import Sequence
from itertools import cycle

import numpy as np
import xarray as xr

from pymc_features._checks import check_group
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.plots.axes import (
    AxesLike,
    check_dataset,
    checked_axes,
    chosen_among,
    figure,
    legend_outside,
    set_figure_title,
    set_title,
)
from pymc_features.plots.histories import share_of

STUDY = "Pass what study.sampling_rate_study() returned."
DIMS = ("likelihood", "multiplier", "parameter")
LABELS = {
    "theta": "stiffness factor θ [-]",
    "sigma": "scale σ [m/s²]",
    "tau": "correlation time τ [s]",
    "beta": "inverse temperature β [-]",
    "epsilon": "tolerance ε [(unit of the data)²]",
    "D": "information [nats]",
    "A": "share of the prior variance [-]",
    "prediction": "share of the response's variance [-]",
}
MARKERS = dict(zip(LIKELIHOODS, cycle("osD^vP<>X"), strict=False))
ENTRY = 1.8  # inches, of a legend
APART = 0.09  # of neighbouring bars at one step, as a share of the step
STATISTICS = ("log_probability", "log_probability_se", "simulations")
NAMED = 12  # events with room for their names
WIDE = 1.645  # standard deviations of 90 %


@figure("One for each parameter")
def sampling_rate(
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
        From `study.sampling_rate_study`.
    likelihoods : str or sequence of str
        Which to draw; ("TN", "NORM") are Figs. 2 (theta) and 3 (sigma) of the source, ("EXP", "NORM", "ABC")
        Fig. 4. Those that have no sigma, or know it, appear for theta only.
    parameters : {"theta", "sigma", "tau"} or sequence of them
        Which to draw.
    """
    summary = check_group(result, "result", "summary", STUDY, *DIMS)
    likelihoods = chosen_among(likelihoods, "likelihoods", summary["likelihood"].values.tolist())
    parameters = chosen_among(parameters, "parameters", summary["parameter"].values.tolist())
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
    *others, last = likelihoods
    listed = f"{', '.join(others)} and {last}" if others else last
    set_figure_title(axes[0].figure, listed, result.attrs.get("title"))
    entries = [len(ax.get_legend_handles_labels()[1]) for ax in axes]
    rows = int(np.ceil(ENTRY * max(entries) / axes[0].figure.get_figwidth()))
    legend_outside(axes[np.argmax(entries)], "lower center", -(-max(entries) // rows))
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


@figure("One", "array of one matplotlib Axes")
def widths(result: xr.DataTree, axes: AxesLike = None) -> np.ndarray:
    """5-95 % width of theta at each sampling step: what a faster sampling does to the uncertainty.

    Lines are exact, by quadrature; markers are sampled.

    Parameters
    ----------
    result : DataTree
        From `study.sampling_rate_study`.
    """
    summary = check_group(result, "result", "summary", STUDY, *DIMS).sel(parameter="theta")
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


def draw_interval(ax, x, ends, middle, colour, labels) -> None:
    """An area between two ends, and a line with dots between them."""
    ax.fill_between(x, *ends, color=colour, alpha=0.3, lw=0, label=labels[0])
    ax.plot(x, middle, "o-", color=colour, ms=3, lw=1.0, label=labels[1])
    ax.legend(frameon=False, fontsize="small")


@figure("One for each scalar parameter")
def tolerance(result: xr.Dataset, axes: AxesLike = None) -> np.ndarray:
    """Median and interval of each scalar parameter against the tolerance.

    Parameters
    ----------
    result : Dataset
        From `sampling.tolerance_sweep`.
    """
    check_dataset(result, "result", "what sampling.tolerance_sweep() returned")
    scalars = (name for name, values in result.data_vars.items() if values.dims == ("epsilon", "quantile"))
    names = [name for name in scalars if name not in STATISTICS]
    if not names:
        raise ValueError("`result` must have a scalar parameter, got none. Select one entry of the vectors.")
    n = len(names)
    axes = checked_axes(axes, n, "scalar parameters", columns=n, figsize=(4.5 * n, 3.4))
    for ax, name in zip(axes, names, strict=True):
        low, middle, high = result[name].transpose("quantile", "epsilon").values
        labels = f"ABC, {share_of(result)}", "median"
        draw_interval(ax, result["epsilon"].values, (low, high), middle, LIKELIHOODS["ABC"].colour, labels)
        ax.set(xscale="log", xlabel="tolerance ε on ρ [squared units of the data]", ylabel=name)
    return axes


@figure("One for each parameter")
def sequence(
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
    """
    advice = "Pass what events.continue_with() returned."
    record = check_group(idata, "idata", "sequence", advice, "event", "parameter")
    names = chosen_among(parameters, "parameters", [str(name) for name in record["parameter"].values])
    axes = checked_axes(axes, len(names), "parameters", figsize=(7.5, 0.6 + 1.8 * len(names)))
    event = record["event"].values
    for ax, name in zip(axes, names, strict=True):
        one = record.sel(parameter=name)
        mean, half = one["mean"].values, WIDE * one["standard_deviation"].values
        for i, at in enumerate(event[record["alarm"].values > 0]):
            ax.axvline(at, color="C3", lw=1.2, ls="--", label=None if i else "alarm")
        draw_interval(ax, event, (mean - half, mean + half), mean, "C0", ("90 %", "mean"))
        ax.set(xlabel="event", ylabel=name)
        ax.xaxis.get_major_locator().set_params(integer=True)
        if "name" in record.coords and event.size <= NAMED:
            ax.set(xlabel="", xticks=event, xticklabels=[])
    if "name" in record.coords and event.size <= NAMED:
        axes[-1].set_xticklabels(record["name"].values.astype(str), rotation=20, ha="right")
    return axes


@figure("Two", "array of two matplotlib Axes")
def tempering(idata: xr.DataTree, axes: AxesLike = None) -> np.ndarray:
    """Inverse temperature, or tolerance of ABC, and acceptance rate at each stage, one line for each chain.

    Parameters
    ----------
    idata : DataTree
        From `sample_smc`: `sample_stats` with beta or epsilon (chain, stage).
    """
    stats = idata["sample_stats"].to_dataset() if "sample_stats" in getattr(idata, "children", ()) else {}
    name = next((n for n in ("epsilon", "beta") if n in stats and "stage" in stats[n].dims), None)
    if name is None:
        raise ValueError(
            "`idata` must be of a sampler with stages, got none in `sample_stats`. Pass what sample_smc() "
            "returned."
        )
    axes = checked_axes(axes, 2, "parts (temperature, acceptance)", columns=2, figsize=(9.0, 3.2))
    for ax, part, label in zip(
        axes, (name, "accept_rate"), (LABELS[name], "acceptance rate [-]"), strict=True
    ):
        if part in stats:
            values = stats[part].where(stats[part] > 0).transpose("stage", "chain").values
            chains = [f"chain {chain}" for chain in stats["chain"].values]
            ax.plot(1 + np.arange(len(values)), values, "o-", ms=3, lw=1.0, label=chains)
        ax.set(xlabel="stage", ylabel=label)
        ax.xaxis.get_major_locator().set_params(integer=True)
    axes[0].set_yscale("log")
    axes[1].set_ylim(0.0, 1.0)
    axes[0].legend(frameon=False)
    return axes


@figure("Two", "array of two matplotlib Axes")
def sensor_placement(result: xr.Dataset, axes: AxesLike = None) -> np.ndarray:
    """What each candidate tells by itself, the chosen ones in their order, and what they tell together.

    Parameters
    ----------
    result : Dataset
        From `sensor_placement`.
    """
    check_dataset(result, "result", "what sensor_placement() returned", "alone", "gain", "sensor")
    axes = checked_axes(axes, 2, "places and numbers of sensors", columns=2, figsize=(8.5, 4.0))
    along, together = axes
    names, alone = list(result["candidate"].values), result["alone"].values
    unit, order = LABELS[result.attrs["criterion"]], result["order"].values
    chosen = [names.index(name) for name in result["sensor"].values]
    along.barh(range(len(names)), alone, color=["C0" if at in chosen else "0.85" for at in range(len(names))])
    for number, at in zip(order, chosen, strict=True):
        along.annotate(str(number), (alone[at], at), xytext=(3, 0), textcoords="offset points", va="center")
    along.set_yticks(range(len(names)), [str(name) for name in names])
    along.set(xlabel=f"{unit}, alone", ylabel="place")
    together.plot(order, result["gain"], "o-", color="C0")
    together.set(xlabel="sensors", ylabel=f"{unit}, together", ylim=(0.0, None), xticks=order)
    return axes
