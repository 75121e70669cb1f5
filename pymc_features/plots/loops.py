"""Hysteresis loops: force against drift of the springs that yield most."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from pymc_features._checks import message, shown
from pymc_features.plots.drawing.axes import AxesLike, checked_axes, chosen_among, set_figure_title


def plot_loops(
    result: xr.DataTree, springs: int | Sequence[int] | None = None, axes: AxesLike = None
) -> np.ndarray:
    """Force of springs against their drift at the true parameter, and the displacement at which they yield.

    Parameters
    ----------
    result : DataTree
        From `sampling_rate_study`, of a structure whose springs can yield.
    springs : int or sequence of int, optional
        Springs to draw, 0 next to the base; by default the three whose peak drift is the largest multiple of
        their yield displacement, the largest first.
    axes : matplotlib Axes or sequence of them, optional
        One for each spring; a new figure by default.

    Returns
    -------
    array of matplotlib Axes
    """
    if not isinstance(result, xr.DataTree):
        raise TypeError(
            message("result", "a DataTree", shown(result), "Pass what sampling_rate_study() returned.")
        )
    if "loops" not in result.children:
        raise ValueError(
            "`result` must be of a structure whose springs can yield, got one without loops. "
            'Run sampling_rate_study(record, structure="bouc-wen").'
        )
    loops = result["loops"].to_dataset()
    known, ductility = loops["spring"].values.tolist(), loops["ductility"]
    if springs is None:
        springs = loops["spring"].values[np.argsort(-ductility.values, kind="stable")[:3]]
    springs = chosen_among(springs, "springs", known)
    is_new, size = axes is None, (1.2 + 2.9 * len(springs), 3.4)
    axes = checked_axes(axes, len(springs), "springs", columns=len(springs), figsize=size)
    if is_new:
        title = ", ".join(filter(None, [result.attrs.get("title"), loops.attrs.get("record")]))
        set_figure_title(axes[0].figure, title)
    for ax, spring in zip(axes, springs, strict=True):
        cell = loops.sel(spring=spring)
        ax.plot(1e3 * cell["drift"], cell["force"], color="C0", lw=0.7)
        for side in (-1.0, 1.0):
            ax.axvline(side * 1e3 * float(cell["yield_displacement"]), color="0.5", lw=0.8, ls="--", zorder=0)
        ax.set(
            xlabel="drift [mm] (dashed: yield displacement)",
            title=f"spring {spring}: ductility {float(cell['ductility']):.2g}",
        )
    axes[0].set_ylabel("force [N]")
    return axes
