"""Fig. 1: the ground acceleration, or the histories of a loading."""

import numpy as np
import xarray as xr

from pymc_features.plots.drawing.axes import AxesLike, checked_axes, set_title
from pymc_features.records import Loading, Record

LABELS = {"support_acceleration": "support acceleration [m/s²]", "force": "force [N]"}


def plot_record(record: Record | Loading | xr.DataTree, axes: AxesLike = None) -> np.ndarray:
    """Ground acceleration against time with its peak, or every history of a loading.

    Parameters
    ----------
    record : Record, Loading or DataTree
        Of the result of a study or an update the record is drawn that it was made with.
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    array of one matplotlib Axes
    """
    if isinstance(record, xr.DataTree):
        record = record_of(record)
    if not isinstance(record, Record | Loading):
        raise TypeError(
            f"`record` must be a Record, a Loading or the result of a study, got {type(record).__name__}. "
            "Make one of an array with Record(acceleration, dt)."
        )
    axes = checked_axes(axes, figsize=(7.0, 2.6))
    ax = axes[0]
    if isinstance(record, Record):
        draw_with_peak(ax, record)
        label = "ground acceleration [m/s²]"
    else:
        for number, values in enumerate(record.values):
            ax.plot(record.time, values, lw=0.7, label=f"input {number}")
        label = LABELS[record.kind]
    ax.axhline(0.0, color="0.8", lw=0.6, zorder=0)
    ax.set(xlabel="time [s]", ylabel=label, xlim=(0.0, record.duration))
    set_title(ax, record.name)
    ax.legend(frameon=False, loc="upper right")
    return axes


def record_of(result: xr.DataTree) -> Record:
    """The record that a study or an update was made with."""
    if "data" not in result.children or "ground_acceleration" not in result["data"]:
        raise ValueError(
            "`record` must hold the ground acceleration in a group `data`, got a DataTree without. Pass the "
            "Record itself."
        )
    data = result["data"].to_dataset()
    return Record.from_channel(
        data["ground_acceleration"].rename(record_time="time").assign_attrs(units="m/s^2"),
        name=data.attrs.get("record", ""),
    )


def draw_with_peak(ax, record: Record) -> None:
    """The ground acceleration, and a mark at its peak."""
    peak = int(np.abs(record.acceleration).argmax())
    ax.plot(record.time, record.acceleration, color="0.25", lw=0.7)
    ax.plot(
        record.time[peak],
        record.acceleration[peak],
        "o",
        color="C3",
        ms=5,
        label=f"peak {record.pga:.3g} m/s²",
    )
