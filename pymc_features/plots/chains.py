"""Whether chains agree: marginal densities and ranks, or traces, by ArviZ."""

from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr

from pymc_features._checks import check_choice, check_finite, check_group
from pymc_features.plots.drawing.axes import AxesLike, checked_axes, chosen_among

KINDS = ("rank", "trace")


def plot_chains(
    idata: xr.DataTree,
    kind: str = "rank",
    var_names: Sequence[str] | None = None,
    axes: AxesLike = None,
) -> np.ndarray:
    """Density of each chain, and the ranks of its draws among all, or their trace.

    The curves of chains that agree, ranks less what is expected of them, stay near the middle; p is that of
    ArviZ's test of it. Draws of SMC have no order: look at ranks; those of NUTS have a trace as well.

    Parameters
    ----------
    idata : DataTree
        With a group `posterior`.
    kind : {"rank", "trace"}
    var_names : sequence of str, optional
        Parameters to draw; all by default.
    axes : sequence of matplotlib Axes, optional
        Two for each entry of a parameter, the density first; a new figure by default.

    Returns
    -------
    array of matplotlib Axes
    """
    import arviz as az  # slow to import

    check_choice(kind, "kind", KINDS)
    draw = az.plot_rank_dist if kind == "rank" else az.plot_trace_dist
    posterior = check_group(idata, "idata", "posterior", "Pass what `sample` returned.", "chain", "draw")
    numbers = [name for name, values in posterior.data_vars.items() if values.dtype.kind in "iuf"]
    names = chosen_among(var_names, "var_names", numbers)
    if not names:
        raise ValueError("`idata` must have a posterior of numbers, got none.")
    for name in names:
        check_finite(posterior[name].values, "idata", f"Those are draws of {name}.")
    labels = list(axis_labels(posterior, names, kind))
    size = 9.0, 0.4 + 0.8 * len(labels)
    axes = checked_axes(
        axes, len(labels), "columns (two for each entry of a parameter)", columns=2, figsize=size
    )
    draw(
        idata,
        var_names=names,
        compact=False,
        plot_collection=collection(posterior[names], axes, kind),
        visuals={"label": False},
    )
    for ax, label in zip(axes, labels, strict=True):
        ax.set_xlabel(label)
    return axes


def axis_labels(posterior: xr.Dataset, names: list[str], kind: str) -> Iterator[str]:
    """Name of each entry of the parameters, for its density and for its ranks or trace."""
    second = ": fractional rank" if kind == "rank" else ": draw"
    for name in names:
        rest = [n for d, n in posterior[name].sizes.items() if d not in ("chain", "draw")]
        for index in np.ndindex(*rest):
            entry = f"{name}{list(index)}" if rest else name
            yield from (entry, f"{entry}{second}")


def collection(posterior: xr.Dataset, axes: np.ndarray, kind: str):
    """The axes as ArviZ wants them: by parameter, its dimensions, and column."""
    from arviz_plots import PlotCollection

    columns = ["dist", kind]
    dims = [d for d in posterior.dims if d not in ("chain", "draw")]
    posterior = posterior.assign_coords({d: posterior[d] for d in dims})  # ArviZ selects by labels
    placed, first = {}, 0
    for name, values in posterior.data_vars.items():
        shape = {d: n for d, n in values.sizes.items() if d in dims}
        last = first + 2 * int(np.prod(list(shape.values()), dtype=int))
        placed[name] = ([*shape, "column"], axes[first:last].reshape(*shape.values(), 2))
        first = last
    coords = {"column": columns, **{d: posterior[d] for d in dims}}
    figure = np.array(axes[0].figure, dtype=object)
    viz = xr.DataTree.from_dict(
        {"/": xr.Dataset({"figure": ((), figure)}), "/plot": xr.Dataset(placed, coords)}
    )
    return PlotCollection(
        posterior.expand_dims(column=2).assign_coords(column=columns),
        viz,
        aes={"color": ["chain"], "overlay": ["chain"]},
        backend="matplotlib",
    )
