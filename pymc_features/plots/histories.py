"""Histories against time: records, channels, and responses with what was measured.

Of more samples than pixels a line hides what lies below it. Time is cut into columns instead, and of each the
smallest and the largest value are drawn: as an area of what was measured, and as two lines of a response that
swings to and fro within a few pixels.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from pymc_features._checks import as_numbers, check_choice, check_group, shown
from pymc_features.plots.axes import (
    AxesLike,
    broken,
    check_dataset,
    checked_axes,
    chosen_among,
    figure,
    inches_of,
    legend_outside,
    set_title,
    with_unit,
)
from pymc_features.records import Loading, Record
from pymc_features.signals.channels import check_array, check_pair

SAMPLES = 2.0  # of each pixel column, above which a line hides what is below it
PIXELS = 6.0  # of an oscillation, below which its line is a blot
WIDEST = 3.0  # height of an axis over that of response and measurement, where errors are large
TALLEST = 30.0  # inches, of a figure of channels
CHANNEL, DENSITY, IN_A_ROW = 1.3, 2.0, 4  # inches of a channel and of a prior below it; priors side by side
LABELS = {"support_acceleration": "support acceleration [m/s²]", "force": "force [N]"}


@figure("One")
def record(record: Record | Loading | xr.DataTree, axes: AxesLike = None) -> np.ndarray:
    """Ground acceleration against time with its peak, or every history of a loading.

    Parameters
    ----------
    record : Record, Loading or DataTree
        Of the result of a study or an update the record is drawn that it was made with.
    """
    if isinstance(record, xr.DataTree):
        record = record_of(record)
    if not isinstance(record, Record | Loading):
        raise TypeError(
            f"`record` must be a Record, a Loading or the result of a study, got {type(record).__name__}. "
            "Make one of an array with Record(acceleration, dt)."
        )
    [ax] = axes = checked_axes(axes, figsize=(7.0, 2.6))
    if isinstance(record, Record):
        draw_with_peak(ax, record.time, record.acceleration, label=f"peak {record.pga:.3g} m/s²")
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
    channel = data["ground_acceleration"].rename(record_time="time").assign_attrs(units="m/s^2")
    how = {"interpolation": data.attrs["interpolation"]} if "interpolation" in data.attrs else {}
    return Record.from_channel(channel, name=data.attrs.get("record", ""), **how)


@figure("One for each sensor")
def channels(channels: xr.DataArray, axes: AxesLike = None) -> np.ndarray:
    """Every channel against time, with its largest value, all on one scale.

    Parameters
    ----------
    channels : DataArray (sensor, time)
        Measured channels [m/s^2], with NaN in gaps.
    """
    check_array(channels, sensors=True)
    time = as_numbers(channels["time"].values, "channels", "Give times in seconds.")
    n, units = channels.sizes["sensor"], units_of(channels)
    layout = {"figsize": (9.0, min(TALLEST, 0.8 + 0.9 * n)), "sharex": True}
    axes = checked_axes(axes, n, "sensors", sharey="units" not in channels.coords, **layout)
    for ax, values, title in zip(axes, channels.values, titles_of(channels), strict=True):
        draw_with_peak(ax, time, values)
        set_title(ax, title, loc="left", fontsize="medium")
    axes[-1].set(xlabel="time [s]", xlim=(float(time[0]), float(time[-1])))
    quantity = "acceleration " if units[0] == "m/s²" else ""
    axes[n // 2].set_ylabel(f"{quantity}[{units[0]}]" if len(set(units)) == 1 else "")
    return axes


def units_of(channels: xr.DataArray) -> list[str]:
    """Unit of each channel: its own, or that of all."""
    whole = [channels.attrs.get("units", "m/s^2")] * channels.sizes["sensor"]
    units = channels["units"].values.tolist() if "units" in channels.coords else whole
    return [unit.replace("^2", "²") for unit in units]


def titles_of(channels: xr.DataArray) -> list[str]:
    """Name and largest value of each channel."""
    largest = np.nanmax(np.abs(channels.values), axis=1)
    columns = zip(channels["sensor"].values, largest, units_of(channels), strict=True)
    return [f"{name}, peak {peak:.3g} {unit}" for name, peak, unit in columns]


def draw_with_peak(ax, time, values, label: str | None = None) -> None:
    """A measured history, and a mark at its largest value."""
    peak = int(np.nanargmax(np.abs(values)))
    ax.plot(time, values, color="0.25", lw=0.7)
    ax.plot(time[peak], values[peak], "o", color="C3", ms=4.5, label=label)


@figure("One for each sensor")
def predictive(
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
    """
    advice = "Pass one likelihood of what `run_update` returned."
    bands = check_group(idata, "idata", "bands", advice, "quantile", "sensor", "time")
    observed = check_group(idata, "idata", "observed_data", advice, "sensor", "time")["y"]
    chosen = chosen_among(sensors, "sensors", bands["sensor"].values.tolist())
    if window is not None:
        window = check_pair(window, "window", "two times (from, to) in seconds")
        bands, observed = (x.sel(time=slice(*window)) for x in (bands, observed))
        if not bands.sizes["time"]:
            raise ValueError(f"`window` must hold samples of the record, got {window} in seconds.")
    bands, observed = bands.sel(sensor=chosen), observed.sel(sensor=chosen)
    axes = checked_axes(axes, len(chosen), "sensors", figsize=(9.0, 1.0 + 1.7 * len(chosen)), sharex=True)
    predictive = bands["predictive"].transpose("quantile", ...).values if "predictive" in bands else None
    labels = f"response, {share_of(bands)}", "median response", f"predictive, {share_of(bands)}"
    draw_responses(axes, bands["response"], list(observed), labels, predictive)
    response = bands["response"].transpose("quantile", ...).values
    unit = with_unit("", observed.attrs.get("units", "m/s^2"))
    for k, (ax, sensor) in enumerate(zip(axes, chosen, strict=True)):
        around = [] if predictive is None else list(predictive[[0, -1], k])
        ax.set_ylim(*limits([observed.values[k], *response[[0, -1], k]], around))
        error = 100.0 * float(bands["normalised_error"][k])
        title = f"{sensor}: rms error of the median {error:.0f} % of the measured rms"
        set_title(ax, title, fontsize="medium")
        ax.set_ylabel(unit)
    legend_outside(axes[0])
    return axes


@figure("One for each sensor")
def response(
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
        From `prediction.posterior_response`.
    quantity : str
        One of its quantities.
    sensors : int or sequence of int, optional
        Sensors, storeys or supports to draw; all by default.
    measured : DataArray (sensor, time) or array_like (sensor, time), optional
        Measured response with its own sensors and times, which may be fewer; or an array for the sensors
        drawn and the times of the result. For the base shear (time).
    """
    check_dataset(result, "result", "what prediction.posterior_response() returned")
    known = [str(name) for name, v in result.data_vars.items() if "quantile" in v.dims]
    check_choice(quantity, "quantity", known)
    bands, dim, chosen = rows(result[quantity], sensors)
    measured = labelled(measured, bands, dim)
    axes = checked_axes(axes, len(chosen), "sensors", figsize=(8.0, 1.0 + 1.8 * len(chosen)), sharex=True)
    known = [] if measured is None else measured[dim].values
    observed = [measured.sel({dim: label}) if label in known else None for label in chosen]
    draw_responses(axes, bands, observed, (share_of(bands), "median"))
    for ax, label in zip(axes, chosen, strict=True):
        ax.set_ylabel(with_unit("", bands.attrs.get("units", "")))
        place = f", {dim} {label}" if dim in result[quantity].dims else ""
        set_title(ax, f"{quantity.replace('_', ' ')}{place}")
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
        if measured.dims == ("time",) and bands.sizes[dim] == 1:
            return measured.expand_dims({dim: bands[dim].values})
        if dim not in measured.dims:
            raise ValueError(
                f"`measured` must have dimensions ({dim}, time), got {measured.dims}. Rename them."
            )
        return measured
    values, like = as_numbers(measured, "measured"), bands.isel(quantile=0, drop=True).transpose(dim, "time")
    if dim == "row":
        values = np.atleast_2d(values)
    if values.shape != like.shape:
        raise ValueError(
            f"`measured` must have shape (sensor, time) = {like.shape} to match the result, got "
            f"{values.shape}. Pass a DataArray with coordinates for other sensors or times."
        )
    return like.copy(data=values)


def draw_expected(channels, bands, densities, units) -> np.ndarray:
    """Each channel on the band that is expected of it, and densities of the priors below them all.

    `channels` (sensor, time) begin with the base, of which there is no band; `bands` (3, sensor, time) are
    the quantiles 5, 50 and 95 % of the others; `densities` and `units` are of parameters by their names.
    """
    from matplotlib import pyplot

    n, rows = channels.sizes["sensor"], -(-len(densities) // IN_A_ROW)
    heights = [0.7 + CHANNEL * n, max(DENSITY * rows, 1e-3)]
    figure = pyplot.figure(figsize=(9.0, sum(heights)), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=heights)
    axes = above.subplots(n, 1, sharex=True, squeeze=False)[:, 0]
    coords = {"quantile": [0.05, 0.5, 0.95], "time": channels["time"]}
    expected = xr.DataArray(bands, coords, ("quantile", "sensor", "time"))
    labels = "priors, 5 to 95 %", "priors, median"
    columns = draw_responses(axes[1:], expected, list(channels[1:]), labels)
    draw_measured(axes[0], channels["time"].values, channels.values[0], columns)
    named = zip(axes, titles_of(channels), channels.values, units_of(channels), strict=True)
    for k, (ax, title, values, unit) in enumerate(named):
        if k:
            low, _, high = bands[:, k - 1]
            inside = ((values >= low) & (values <= high))[~np.isnan(values)]
            title += f": {100.0 * inside.mean():.0f} % of it within what the priors expect"
            ax.set_ylim(*limits([values], [low, high]))
        set_title(ax, title, loc="left", fontsize="medium")
        ax.margins(x=0.0)
        ax.set_ylabel(f"[{unit}]")
    legend_outside(axes[-1])
    of_priors = [below.add_subplot(rows, IN_A_ROW, 1 + k) for k in range(len(densities))]
    for ax, (name, (values, density)) in zip(of_priors, densities.items(), strict=True):
        ax.fill_between(values, density, color="0.7", lw=0.0)
        label = f"{with_unit(name, units.get(name, '').strip('-'))}, prior"
        ax.set(xlabel=broken(label, inches_of(ax), "medium"), yticks=[], xlim=(values[0], values[-1]))
        ax.set_ylim(bottom=0.0)
        ax.xaxis.get_major_locator().set_params(nbins=4)
    return np.array([*axes, *of_priors])


def share_of(bands) -> str:
    """Probability between the ends of bands, in words."""
    probabilities = bands["quantile"].values
    return f"{100.0 * (probabilities[-1] - probabilities[0]):g} %"


def draw_responses(axes, bands: xr.DataArray, measured: Sequence, labels, around=None) -> "Columns | None":
    """Band and median of each response (quantile, row, time), what was measured of it, and a band around."""
    bands = bands.transpose("quantile", ..., "time")
    time, low, high = bands["time"].values, bands.values[0], bands.values[-1]
    median = bands.sel(quantile=0.5).values if 0.5 in bands["quantile"] else None
    columns = columns_of(axes[0], time, bands.values[len(bands) // 2])
    for k, (ax, observed) in enumerate(zip(axes, measured, strict=True)):
        if around is not None:
            style = {"color": "C0", "alpha": 0.18, "zorder": 0.8, "label": labels[2]}
            draw_area(ax, time, around[0, k], around[-1, k], columns, **style)
        draw_band(ax, time, low[k], high[k], columns, color="C0", alpha=0.4, label=labels[0])
        if median is not None:
            draw_line(ax, time, median[k], columns, color="C0", lw=0.9, label=labels[1])
        if observed is not None:
            draw_measured(ax, observed["time"].values, observed.values, columns)
        ax.margins(x=0.0)
    axes[-1].set_xlabel("time [s]")
    return columns


class Columns(NamedTuple):
    """How wide the columns are into which time is cut [s], and whether responses are too fast for a line."""

    width: float
    is_fast: bool


def columns_of(ax, time: np.ndarray, responses: np.ndarray) -> Columns | None:
    """Columns for responses (sensor, time), each across an axis as wide as this one; None: lines show them.

    Columns are as wide as a pixel, or as a mean oscillation of what is too fast for a line.
    """
    pixels = max(1, int(ax.get_window_extent().width))
    if time.size <= SAMPLES * pixels:
        return None
    is_below = responses < responses.mean(axis=-1, keepdims=True)
    oscillations = 0.5 * np.count_nonzero(np.diff(is_below, axis=-1)) / len(responses)
    is_fast = PIXELS * oscillations > pixels
    count = min(pixels, oscillations) if is_fast else pixels
    return Columns(float(time[-1] - time[0]) / count, is_fast)


def envelope(time: np.ndarray, values: np.ndarray, width: float) -> tuple[np.ndarray, ...]:
    """Time [s], smallest and largest value of each column, from the first sample to the last.

    Neighbouring columns share a sample, so that an area between them has no gaps.
    """
    count = max(1, round((time[-1] - time[0]) / width))
    starts = np.unique(np.arange(count) * (time.size - 1) // count)
    ends = np.append(starts[1:], time.size - 1)
    low, high = (extreme(extreme.reduceat(values, starts), values[ends]) for extreme in (np.fmin, np.fmax))
    middle = 0.5 * (time[starts] + time[ends])
    middle[0], middle[-1] = time[0], time[-1]
    return middle, low, high


def draw_area(ax, time, low, high, columns, **style) -> None:
    """All between two histories."""
    if columns is not None:
        (time, low, _), (_, _, high) = (envelope(time, values, columns.width) for values in (low, high))
    ax.fill_between(time, low, high, **{"lw": 0} | style)


def ends_of(time, values, columns) -> tuple[np.ndarray, list[np.ndarray]]:
    """A history, or both ends of the envelope of a fast one, with their times."""
    if columns is None or not columns.is_fast:
        return time, [values]
    middle, *ends = envelope(time, values, columns.width)
    return middle, ends


def draw_band(ax, time, low, high, columns, **style) -> None:
    """What lies between two histories; of fast ones, between the lower and the upper ends of envelopes."""
    (at, lower), (_, upper) = (ends_of(time, values, columns) for values in (low, high))
    for one, other in zip(lower, upper, strict=True):
        ax.fill_between(at, one, other, **{"lw": 0} | style)
        style.pop("label", None)


def draw_line(ax, time, values, columns, **style) -> None:
    """A history, or both ends of the envelope of a fast one."""
    at, ends = ends_of(time, values, columns)
    for end in ends:
        ax.plot(at, end, **style)
        style.pop("label", None)


def draw_measured(ax, time, values, columns) -> None:
    """What was measured: dashes above lines, or an area below them, which is always wider than they are."""
    if columns is None:
        ax.plot(time, values, color="0.1", lw=0.7, ls="--", label="measured")
    else:
        width = 0.0 if columns.is_fast else 2.5
        draw_area(ax, time, values, values, columns, color="0.65", lw=width, zorder=0.9, label="measured")


def limits(inside, around) -> tuple[float, float]:
    """Limits of an axis for all of some histories, and as much of others as leaves these readable."""
    low, high = min(map(np.nanmin, inside)), max(map(np.nanmax, inside))
    room = 0.5 * (WIDEST - 1.0) * (high - low)
    if around:
        low = max(min(low, *map(np.nanmin, around)), low - room)
        high = min(max(high, *map(np.nanmax, around)), high + room)
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin
