"""Bands of a response under the posterior, against time."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from pymc_features._checks import as_numbers, check_choice, message, shown
from pymc_features.plots.drawing.axes import AxesLike, checked_axes, chosen_among, set_title
from pymc_features.plots.drawing.envelope import columns_of, draw_band, draw_line, draw_measured


def plot_response_bands(
    result: xr.Dataset,
    quantity: str,
    sensors: int | Sequence[int] | None = None,
    measured: xr.DataArray | ArrayLike | None = None,
    axes: AxesLike = None,
) -> np.ndarray:
    """Band and median of a response at chosen sensors or storeys, with what was measured.

    The band is between the lowest and the highest quantile of the result. It holds the uncertainty of the
    parameters, not the error of the measurement: measured samples are not expected to lie in it.

    Parameters
    ----------
    result : Dataset
        From `posterior_response`.
    quantity : str
        One of its quantities.
    sensors : int or sequence of int, optional
        Sensors, storeys or supports to draw; all by default.
    measured : DataArray (sensor, time) or array_like (sensor, time), optional
        Measured response with its own sensors and times, which may be fewer; or an array for the sensors
        drawn and the times of the result. For the base shear (time).
    axes : matplotlib Axes or sequence of them, optional
        One for each sensor; a new figure by default.

    Returns
    -------
    array of matplotlib Axes
    """
    if not isinstance(result, xr.Dataset):
        raise TypeError(
            message("result", "a Dataset", shown(result), "Pass what posterior_response() returned.")
        )
    known = [str(name) for name, v in result.data_vars.items() if "quantile" in v.dims]
    check_choice(quantity, "quantity", known)
    bands, dim, chosen = rows(result[quantity], sensors)
    measured = labelled(measured, bands, dim)
    size = 8.0, 1.0 + 1.8 * len(chosen)
    axes = checked_axes(axes, len(chosen), "sensors", figsize=size, sharex=True)
    middle = bands.isel(quantile=bands.sizes["quantile"] // 2).transpose(dim, "time")
    columns = columns_of(axes[0], bands["time"].values, middle.values)
    for ax, label in zip(axes, chosen, strict=True):
        known = measured is not None and label in measured[dim].values
        draw_one(ax, bands.sel({dim: label}), measured.sel({dim: label}) if known else None, columns)
        unit = bands.attrs.get("units", "").replace("^2", "²")
        place = f", {dim} {label}" if dim in result[quantity].dims else ""
        ax.set_ylabel(f"[{unit}]")
        set_title(ax, f"{quantity.replace('_', ' ')}{place}")
    axes[-1].set_xlabel("time [s]")
    axes[0].legend(frameon=False, loc="upper right", ncols=3)
    return axes


def rows(bands, sensors):
    """The bands of the chosen sensors, the name of their dimension, and their labels."""
    dim = next((d for d in ("sensor", "storey", "support") if d in bands.dims), None)
    if dim is None:
        if sensors is not None:
            raise ValueError(f"`sensors` must be left out for a {bands.name}, got {shown(sensors)}.")
        return bands.expand_dims("row").assign_coords(row=[0]), "row", [0]
    chosen = chosen_among(sensors, "sensors", bands[dim].values.tolist(), "Predict the others first.")
    return bands.sel({dim: chosen}), dim, chosen


def labelled(measured, bands, dim):
    """What was measured, as a DataArray (dim, time), or None."""
    if measured is None:
        return None
    if isinstance(measured, xr.DataArray) and "time" in measured.coords:
        if dim in measured.dims:
            return measured
        if measured.ndim == 1 and bands.sizes[dim] == 1:
            return measured.expand_dims({dim: bands[dim].values})
        raise ValueError(f"`measured` must have dimensions ({dim}, time), got {measured.dims}. Rename them.")
    values, shape = as_numbers(measured, "measured"), (bands.sizes[dim], bands.sizes["time"])
    if dim == "row":
        values = np.atleast_2d(values)
    if values.shape != shape:
        raise ValueError(
            f"`measured` must have shape (sensor, time) = {shape} to match the result, got {values.shape}. "
            "Pass a DataArray with coordinates for other sensors or times."
        )
    return xr.DataArray(values, {dim: bands[dim].values, "time": bands["time"].values}, (dim, "time"))


def draw_one(ax, bands, measured, columns):
    """Band, median and measurement of one sensor."""
    bands = bands.transpose("quantile", "time")
    time, probabilities = bands["time"].values, bands["quantile"].values
    share = 100.0 * (probabilities[-1] - probabilities[0])
    draw_band(ax, time, *bands.values[[0, -1]], columns, color="C0", alpha=0.3, label=f"{share:g} %")
    if 0.5 in probabilities:
        draw_line(ax, time, bands.sel(quantile=0.5).values, columns, color="C0", lw=1.0, label="median")
    if measured is not None:
        draw_measured(ax, measured["time"].values, measured.values, columns)
    ax.margins(x=0.0)
