"""What was measured, in the bands of the updated model."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from pymc_features._checks import as_numbers, check_group, message, shown
from pymc_features.plots.drawing.axes import AxesLike, checked_axes, chosen_among, set_title
from pymc_features.plots.drawing.envelope import columns_of, draw_area, draw_band, draw_line, draw_measured

WIDEST = 3.0  # height of an axis over that of response and measurement, where errors are large


def plot_predictive(
    idata: xr.DataTree,
    sensors: str | Sequence[str] | None = None,
    window: tuple[float, float] | None = None,
    axes: AxesLike = None,
) -> np.ndarray:
    """Bands of the response, and of data like those measured, at each sensor.

    The darker band holds the uncertainty of the parameters; the lighter one, where there is one, the errors
    of the likelihood besides: measured samples should lie in it.

    Parameters
    ----------
    idata : DataTree
        One likelihood of `run_update`: `bands` with response and predictive (quantile, sensor, time)
        [m/s^2], `observed_data` with y (sensor, time).
    sensors : str or sequence of str, optional
        To draw; all by default.
    window : tuple of float, optional
        (from, to) [s]; all by default.
    axes : matplotlib Axes or sequence of them, optional
        One for each sensor; a new figure by default.

    Returns
    -------
    array of matplotlib Axes
    """
    advice = "Pass one likelihood of what `run_update` returned."
    bands = check_group(idata, "idata", "bands", advice, "quantile", "sensor", "time")
    observed = check_group(idata, "idata", "observed_data", advice, "sensor", "time")["y"]
    chosen = chosen_among(sensors, "sensors", bands["sensor"].values.tolist())
    if window is not None:
        window = checked_window(window)
        bands, observed = (x.sel(time=slice(*window)) for x in (bands, observed))
        if not bands.sizes["time"]:
            raise ValueError(f"`window` must hold samples of the record, got {window} in seconds.")
    units = observed.attrs.get("units", "m/s^2").replace("^2", "²")
    size = 9.0, 1.0 + 1.7 * len(chosen)
    axes = checked_axes(axes, len(chosen), "sensors", figsize=size, sharex=True)
    median = bands["response"].sel(quantile=0.5, sensor=chosen).transpose("sensor", "time")
    columns = columns_of(axes[0], bands["time"].values, median.values)
    for ax, sensor in zip(axes, chosen, strict=True):
        _draw(ax, bands.sel(sensor=sensor), observed.sel(sensor=sensor), columns)
        error = 100.0 * float(bands["normalised_error"].sel(sensor=sensor))
        title = f"{sensor}: rms error of the median {error:.0f} % of the measured rms"
        set_title(ax, title, fontsize="medium")
        ax.set_ylabel(f"[{units}]")
    axes[-1].set_xlabel("time [s]")
    handles, labels = axes[0].get_legend_handles_labels()
    axes[0].figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
    return axes


def checked_window(window) -> tuple[float, float]:
    """Two times [s]."""
    edges = as_numbers(window, "window", "Pass two times (from, to) in seconds.")
    if edges.shape != (2,) or not np.isfinite(edges).all():
        raise ValueError(message("window", "two times (from, to) in seconds", shown(window)))
    return float(edges[0]), float(edges[1])


def _draw(ax, bands, observed, columns):
    """Bands, median and measurement of one sensor."""
    time, probabilities = bands["time"].values, bands["quantile"].values
    share = f"{100.0 * (probabilities[-1] - probabilities[0]):g} %"
    median = bands["response"].sel(quantile=0.5).values
    edges = {
        name: bands[name].transpose("quantile", "time").values[[0, -1]]
        for name in ("predictive", "response")
        if name in bands
    }
    if "predictive" in edges:
        label = f"predictive, {share}"
        draw_area(ax, time, *edges["predictive"], columns, color="C0", alpha=0.18, zorder=0.8, label=label)
    draw_band(ax, time, *edges["response"], columns, color="C0", alpha=0.4, label=f"response, {share}")
    draw_line(ax, time, median, columns, color="C0", lw=0.9, label="median response")
    draw_measured(ax, time, observed.values, columns)
    ax.margins(x=0.0)
    ax.set_ylim(*limits([observed.values, *edges["response"]], list(edges.get("predictive", []))))


def limits(inside, around) -> tuple[float, float]:
    """Of an axis that shows all of some histories, and of others around them what leaves these readable."""
    low, high = min(map(np.nanmin, inside)), max(map(np.nanmax, inside))
    room = 0.5 * (WIDEST - 1.0) * (high - low)
    if around:
        low = max(min(low, *map(np.nanmin, around)), low - room)
        high = min(max(high, *map(np.nanmax, around)), high + room)
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin
