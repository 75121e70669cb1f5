"""Hysteresis loops: of the springs that yield most, or of the specimen of a cyclic test."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from pymc_features._checks import as_numbers, message, shown
from pymc_features.plots.drawing.axes import AxesLike, checked_axes, chosen_among, set_figure_title
from pymc_features.plots.drawing.cyclic import draw_test


def plot_loops(
    result: xr.DataTree | xr.Dataset,
    springs: int | Sequence[int] | None = None,
    axes: AxesLike = None,
    *,
    measured: xr.DataArray | ArrayLike | None = None,
) -> np.ndarray:
    """Force of springs against their drift at the true parameter, and the displacement at which they yield.

    Or the force of a specimen against its displacement, in three consecutive parts of a cyclic test: band and
    median under the posterior, and what was measured.

    Parameters
    ----------
    result : DataTree or Dataset
        From `sampling_rate_study`, of a structure whose springs can yield; or from `posterior_response`, of a
        `HystereticSpecimen`.
    springs : int or sequence of int, optional
        Springs to draw, 0 next to the base; by default the three whose peak drift is the largest multiple of
        their yield displacement, the largest first.
    axes : matplotlib Axes or sequence of them, optional
        One for each spring, or for each of the three parts; a new figure by default.
    measured : DataArray or array_like (sensor, time) or (time,), optional
        Measured force [N] of a specimen, as of `read_cyclic_test`.

    Returns
    -------
    array of matplotlib Axes
    """
    if isinstance(result, xr.Dataset):
        return loops_of_specimen(result, springs, measured, axes)
    if measured is not None:
        raise ValueError("`measured` must be left out for a study, got it. Its loops are simulated.")
    if not isinstance(result, xr.DataTree):
        raise TypeError(
            message(
                "result", "a DataTree or Dataset", shown(result), "Pass what sampling_rate_study() returned."
            )
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


def loops_of_specimen(result, springs, measured, axes) -> np.ndarray:
    """Loops under the posterior, from `posterior_response`."""
    if springs is not None:
        raise ValueError(f"`springs` must be left out for a specimen, got {shown(springs)}. It is one.")
    if "restoring_force" not in result or "displacement" not in result.coords:
        raise ValueError(
            "`result` must have the restoring_force of a specimen, got a Dataset without. Pass what "
            'posterior_response(idata, specimen, test, "restoring_force") returned.'
        )
    force = result["restoring_force"].isel(sensor=0).transpose("quantile", "time")
    displacement, probabilities = force["displacement"].values, force["quantile"].values
    if measured is not None:
        measured = np.ravel(as_numbers(measured, "measured"))
        if measured.size != displacement.size:
            raise ValueError(
                f"`measured` must have the {displacement.size} samples of the result, got {measured.size}."
            )
    bands = force.values[[0, force.sizes["quantile"] // 2, -1]]
    share = 100.0 * (probabilities[-1] - probabilities[0])
    return draw_test(displacement, bands, measured, axes, f"{share:g} %")
