"""Whether chains agree: marginal densities and ranks, or traces, by ArviZ."""

import numpy as np

KINDS = ("rank", "trace")


def plot_chains(idata, kind="rank", var_names=None):
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

    Returns
    -------
    array of matplotlib Axes
    """
    import arviz as az  # slow to import

    if kind not in KINDS:
        raise ValueError(f"`kind` must be one of {', '.join(KINDS)}, got {kind!r}.")
    draw = az.plot_rank_dist if kind == "rank" else az.plot_trace_dist
    names = list(idata["posterior"].data_vars) if var_names is None else list(var_names)
    size = 9.0, 0.4 + 1.6 * len(names)
    collection = draw(
        idata,
        var_names=names,
        compact=False,
        backend="matplotlib",
        visuals={"label": False},
        figure_kwargs={"figsize": size, "figsize_units": "inches", "layout": "constrained"},
    )
    axes = np.asarray(collection.viz["figure"].item().axes)
    for ax, (name, column) in zip(axes, named_axes(idata, names, kind), strict=True):
        ax.set_xlabel(f"{name}{column}")
    return axes


def named_axes(idata, names, kind):
    """Name of the parameter and of the column of each axes, row by row."""
    second = ": fractional rank" if kind == "rank" else ": draw"
    for name in names:
        rest = [n for d, n in idata["posterior"][name].sizes.items() if d not in ("chain", "draw")]
        for index in np.ndindex(*rest):
            entry = f"{name}{list(index)}" if rest else name
            yield from ((entry, ""), (entry, second))
