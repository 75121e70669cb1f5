"""Hysteresis loops: of the springs that yield most, or of the specimen of a cyclic test."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from pymc_features._checks import as_numbers, shown
from pymc_features.plots.axes import AxesLike, checked_axes, chosen_among, figure, set_figure_title, set_title
from pymc_features.plots.histories import share_of

PARTS = 3  # of a cyclic test, side by side: loops lie on loops


@figure("One for each spring, or for each of the three parts")
def loops(
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
        `structures.HystereticSpecimen`.
    springs : int or sequence of int, optional
        Springs to draw, 0 next to the base; by default the three whose peak drift is the largest multiple of
        their yield displacement, the largest first.
    measured : DataArray or array_like (sensor, time) or (time,), optional
        Measured force [N] of a specimen, as of `io.read_cyclic_test`.
    """
    if isinstance(result, xr.Dataset):
        if springs is not None:
            raise ValueError(f"`springs` must be left out for a specimen, got {shown(springs)}. It is one.")
        return loops_of_specimen(result, measured, axes)
    if measured is not None:
        raise ValueError("`measured` must be left out for a study, got it. Its loops are simulated.")
    if "loops" not in getattr(result, "children", ()):
        raise ValueError(
            "`result` must be of a structure whose springs can yield, got one without loops. "
            'Run sampling_rate_study(record, structure="bouc-wen").'
        )
    loops = result["loops"].to_dataset()
    most = loops["spring"].values[np.argsort(-loops["ductility"].values, kind="stable")[:PARTS]]
    springs = chosen_among(most if springs is None else springs, "springs", loops["spring"].values.tolist())
    is_new, size = axes is None, (1.2 + 2.9 * len(springs), 3.4)
    axes = checked_axes(axes, len(springs), "springs", columns=len(springs), figsize=size)
    if is_new:
        set_figure_title(axes[0].figure, result.attrs.get("title"), loops.attrs.get("record"))
    for ax, spring in zip(axes, springs, strict=True):
        cell = loops.sel(spring=spring)
        ax.plot(1e3 * cell["drift"], cell["force"], color="C0", lw=0.7)
        for side in (-1.0, 1.0):
            ax.axvline(side * 1e3 * float(cell["yield_displacement"]), color="0.5", lw=0.8, ls="--", zorder=0)
        ax.set_xlabel("drift [mm] (dashed: yield displacement)")
        ax.set_title(f"spring {spring}: ductility {float(cell['ductility']):.2g}")
    axes[0].set_ylabel("force [N]")
    return axes


def loops_of_specimen(result, measured, axes) -> np.ndarray:
    """Force against displacement in consecutive parts of a test, under the posterior and as measured."""
    from matplotlib.collections import PolyCollection

    if "restoring_force" not in result or "displacement" not in result.coords:
        raise ValueError(
            "`result` must have the restoring_force of a specimen, got a Dataset without. Pass what "
            'posterior_response(idata, specimen, test, "restoring_force") returned.'
        )
    force = result["restoring_force"].isel(sensor=0).transpose("quantile", "time")
    displacement, bands = 1e3 * force["displacement"].values, force.values[[0, len(force) // 2, -1]]
    if measured is not None:
        measured = np.ravel(as_numbers(measured, "measured"))
        if measured.size != displacement.size:
            raise ValueError(
                f"`measured` must have the {displacement.size} samples of the result, got {measured.size}."
            )
    axes = checked_axes(axes, PARTS, "parts of the test", columns=PARTS, figsize=(11.0, 3.8), sharey=True)
    scale, unit = scaled(np.abs(bands).max())
    edges = np.linspace(0, displacement.size - 1, PARTS + 1).astype(int)
    for ax, first, last in zip(axes, edges[:-1], edges[1:], strict=True):
        span = slice(first, last + 1)
        x, (low, middle, high) = displacement[span], bands[:, span] / scale
        areas = PolyCollection(
            strips(x, low, high), facecolor="C0", alpha=0.35, lw=0.0, label=share_of(force)
        )
        ax.add_collection(areas)
        ax.plot(x, middle, color="C0", lw=1.0, label="median")
        if measured is not None:
            ax.plot(x, measured[span] / scale, color="0.15", lw=0.8, ls="--", label="measured")
        ax.set_xlabel("displacement [mm]")
        set_title(ax, f"samples {first} to {last}", fontsize="medium")
    axes[0].set_ylabel(f"force [{unit}]")
    axes[0].legend(frameon=False, fontsize="small")
    return axes


def scaled(largest: float) -> tuple[float, str]:
    """What forces are divided by, and their unit then."""
    return next(((f, unit) for f, unit in ((1e6, "MN"), (1e3, "kN")) if largest >= f), (1.0, "N"))


def strips(x, low, high) -> np.ndarray:
    """Corners (step, 4, 2) of what lies between two lines over each step of a path."""
    across = np.stack([x[:-1], x[1:], x[1:], x[:-1]], axis=1)
    return np.stack([across, np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)], axis=2)
