"""What the data have taught: prior against posterior."""

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from pymc_features._checks import check_group, check_mapping, message, shown
from pymc_features.plots.drawing.axes import AxesLike, broken, checked_axes, chosen_among, inches_of

BINS = 40


def plot_prior_posterior(
    idata: xr.DataTree,
    var_names: Sequence[str] | None = None,
    units: Mapping[str, str] | None = None,
    axes: AxesLike = None,
) -> np.ndarray:
    """Histograms of prior and posterior of each scalar parameter, each to its own height.

    Parameters
    ----------
    idata : DataTree
        Groups `posterior` and `prior` (chain, draw).
    var_names : sequence of str, optional
        Parameters to draw; by default all scalars that both groups have.
    units : dict, optional
        Names of parameters to their units, for the labels.
    axes : matplotlib Axes or sequence of them, optional
        One for each parameter; a new figure by default.

    Returns
    -------
    array of matplotlib Axes
    """
    advice = "Pass draws of both, such as one likelihood of what `run_update` returned."
    posterior, prior = (
        check_group(idata, "idata", group, advice, "chain", "draw") for group in ("posterior", "prior")
    )
    units = check_mapping(units, "units", "a dict of parameters to their units")
    if not all(isinstance(unit, str) for unit in units.values()):
        raise TypeError(message("units", "a dict of parameters to their units", shown(units)))
    known = [
        str(n) for n, v in posterior.data_vars.items() if n in prior and set(v.dims) == {"chain", "draw"}
    ]
    names = chosen_among(var_names, "var_names", known)
    if not names:
        raise ValueError("`idata` must have scalar parameters in both groups, got none.")
    is_new, columns = axes is None, min(4, len(names))
    size = 2.6 * columns, 0.5 + 2.2 * -(-len(names) // columns)
    axes = checked_axes(axes, len(names), "parameters", columns=columns, figsize=size)
    if is_new:
        # inches, between the numbers below neighbours
        axes[0].figure.get_layout_engine().set(w_pad=0.12)
    for ax, name in zip(axes, names, strict=True):
        before, after = prior[name].values.ravel(), posterior[name].values.ravel()
        low, high = np.quantile(before, [0.005, 0.995])  # a far tail would leave nothing to see
        low, high = min(low, np.quantile(after, 0.001)), max(high, np.quantile(after, 0.999))
        # each as fine as it asks for; as densities a narrow posterior would leave no prior to see
        for draws, bins, colour, label in (
            (before, np.linspace(low, high, BINS + 1), "0.75", "prior"),
            (after, "auto", "C0", "posterior"),
        ):
            counts, edges = np.histogram(draws, bins)
            ax.stairs(counts / counts.max(), edges, fill=True, color=colour, alpha=0.6, label=label)
        ax.axvline(np.median(after), ymax=0.95, color="C0", lw=1.0)  # a posterior thinner than a line is seen
        unit = units.get(name, "").replace("^2", "²")
        label = broken(f"{name} [{unit}]" if unit else name, inches_of(ax), "medium")
        ax.set(xlabel=label, yticks=[], xlim=(low, high))
        ax.xaxis.get_major_locator().set_params(nbins=4)
    handles, labels = axes[0].get_legend_handles_labels()
    axes[0].figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    return axes
