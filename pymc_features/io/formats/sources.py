"""Channels that are in memory: pandas, xarray, ObsPy, and the dicts of SEP005."""

from collections.abc import Mapping
from datetime import UTC, datetime

import numpy as np

from pymc_features._checks import as_list, listed, message, shown
from pymc_features.io.reading.labels import Label, role_of
from pymc_features.io.reading.recording import Channel, Columns, Recording, Request, recording_of

SEP005 = "data", "name", "unit_str"


def is_source(value) -> bool:
    """Whether a value holds channels by itself, rather than being the path of a file."""
    kind = type(value)
    if {"DataFrame", "DataArray", "Stream"} & {base.__name__ for base in kind.__mro__}:
        return True
    entries = as_list(value) if isinstance(value, list | tuple) else None
    return bool(entries) and all(isinstance(entry, Mapping) and "data" in entry for entry in entries)


def recording_in(source, request: Request) -> Recording:
    """The channels of a `pandas.DataFrame`, an `xarray.DataArray`, an ObsPy `Stream` or a list of SEP005."""
    names = {base.__name__ for base in type(source).__mro__}
    if "DataFrame" in names:
        return _of_frame(source, request)
    if "DataArray" in names:
        return _of_array(source)
    if "Stream" in names:
        return Recording("the Stream", channels_of(source.copy().merge(method=0), "the Stream", {}))
    return Recording("the list", [_of_dict(entry) for entry in source])


def channels_of(stream, source: str, rates: dict[str, float]) -> list[Channel]:
    """The traces of a stream; NaN in gaps."""
    channels, codes = [], [trace.stats.channel for trace in stream]
    for trace in stream:
        sac = trace.stats.get("sac", {})
        uneven = sac.get("leven", 1) != 1 or sac.get("iftype", 1) != 1
        if uneven or trace.data.dtype.kind not in "iuf" or not trace.stats.delta > 0.0:
            raise ValueError(
                f"{source} must hold an even series of numbers, {trace.id} is none. Resample it."
            )
        name = trace.stats.channel if trace.stats.channel and len(set(codes)) == len(codes) else trace.id
        values = np.ma.filled(trace.data.astype(np.float64), np.nan)
        # of SAC in single precision; ObsPy rounds it to microseconds
        stated = float(f"{sac['delta']:.7g}") if "delta" in sac else trace.stats.delta
        step, start = rates.get(trace.id, stated), trace.stats.starttime.timestamp
        channels.append(Channel(name, values, None, float(step), start=float(start)))
    return channels


def _of_frame(frame, request: Request) -> Recording:
    """Columns by their labels; an index that is named as a time, or holds dates, is the clock."""
    labels = [Label.of(str(name)) for name in frame.columns]
    if other := [str(name) for name, kind in frame.dtypes.items() if kind.kind not in "iufb"]:
        what = f"a DataFrame with {listed(other)}"
        raise ValueError(f"`files` must hold numbers, got {what}. Drop these columns.")
    values, stamp, origin, index = frame.to_numpy(dtype=np.float64), None, 0.0, frame.index
    dates = index.dtype.kind in "mM"
    if dates or (index.name is not None and role_of(str(index.name)) == "time"):
        origin, seconds = _seconds(index.to_numpy())
        values, stamp = np.insert(values, 0, seconds, axis=1), 0 if dates else None
        labels = [Label("time", "time") if dates else Label.of(str(index.name)), *labels]
    columns = Columns(
        "the DataFrame",
        labels,
        values[request.skip :],
        lambda row, _: f"row {row}",
        stamp=stamp,
        origin=origin,
    )
    return recording_of(columns, request)


def _seconds(times: np.ndarray) -> tuple[float, np.ndarray]:
    """The first of some dates [s since 1970], or 0 of durations and numbers, and the times (time,) since."""
    if times.dtype.kind not in "mM":
        return 0.0, times.astype(np.float64)
    nanoseconds = times.astype(f"{times.dtype.kind}8[ns]").astype(np.int64)
    first = int(nanoseconds[0]) if times.dtype.kind == "M" else 0
    return first * 1e-9, (nanoseconds - first) * 1e-9


def _of_array(array) -> Recording:
    """Sensors by the coordinate `sensor`, times [s] or dates by the coordinate `time`, `units` in `attrs`."""
    if not set(array.dims) <= {"sensor", "time"} or "time" not in array.dims:
        raise ValueError(
            message("files", "a DataArray (sensor, time)", str(array.dims), "Rename and transpose it.")
        )
    whole = array.expand_dims("sensor") if "sensor" not in array.dims else array
    whole = whole.transpose("sensor", "time")
    names = whole["sensor"].values if "sensor" in array.coords else range(whole.sizes["sensor"])
    units = (
        whole.coords["units"].values if "units" in whole.coords else [array.attrs.get("units")] * len(names)
    )
    place = {}
    if "time" in array.coords:
        origin, seconds = _seconds(whole["time"].values)
        unit = "s" if whole["time"].dtype.kind in "mM" else str(whole["time"].attrs.get("units", "s"))
        place = _place("the DataArray", seconds, unit, origin + float(array.attrs.get("start", 0.0)))
    channels = [
        Channel(str(name), row.astype(np.float64), None if unit is None else str(unit), **place)
        for name, row, unit in zip(names, whole.values, units, strict=True)
    ]
    return Recording("the DataArray", channels)


def _of_dict(entry: Mapping) -> Channel:
    """A channel by SEP005, proposal 5 of the Structural Health Monitoring community's `sdypy`.

    `data` (time,), `name`, `unit_str`, `fs` [Hz] or `time` (time,) [s], `start_timestamp` as text or date.
    """
    missing = [key for key in SEP005 if key not in entry]
    if missing or not ("fs" in entry or "time" in entry):
        raise ValueError(
            f"`files` must be dicts with {', '.join(SEP005)} and `fs` or `time`, got one with "
            f"{listed(list(entry))}. Complete it."
        )
    start = entry.get("start_timestamp")
    if isinstance(start, str):
        try:
            start = datetime.fromisoformat(start)
        except ValueError:
            raise ValueError(message("start_timestamp", "an ISO date", shown(start))) from None
    if isinstance(start, datetime):
        start = (start if start.tzinfo else start.replace(tzinfo=UTC)).timestamp()
    dt = 1.0 / float(entry["fs"]) if "fs" in entry else None
    place = {"dt": dt, "start": start}
    if "time" in entry:
        place = _place(str(entry["name"]), entry["time"], "s", start or 0.0, dt)
    return Channel(
        str(entry["name"]), np.asarray(entry["data"], dtype=np.float64), str(entry["unit_str"]), **place
    )


def _place(source: str, times, unit: str, start: float, dt: float | None = None) -> dict:
    """Step and start of a channel by its times (time,), in a unit, and what they count from [s]."""
    readings = np.asarray(times, dtype=np.float64)[:, None]
    label = Label("time", "time", unit)
    columns = Columns(source, [label], readings, lambda row, column: f"{source}, sample {row}", dt=dt)
    [clock] = recording_of(columns, Request()).channels
    return {"dt": clock.dt, "start": start + clock.start}
