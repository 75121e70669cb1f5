"""Whether chains agree: marginal densities and ranks, or traces, by ArviZ."""

import numpy as np

KINDS = ("rank", "trace")


def plot_chains(idata, kind="rank", var_names=None):
    """Density of each chain, and the ranks of its draws among all, or their trace.

    Ranks of chains that agree stay within the shaded band. Draws of SMC have no order: look at ranks; those
    of NUTS have a trace as well.

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
    size = 9.0, 0.6 + 1.5 * len(names)
    collection = draw(
        idata,
        var_names=names,
        compact=False,
        backend="matplotlib",
        figure_kwargs={"figsize": size, "figsize_units": "inches"},
    )
    figure = collection.viz["figure"].item()
    return np.asarray(figure.axes)
