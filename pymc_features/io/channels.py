"""Measured channels of several sensors, from files or from memory, on their common clock."""

from collections.abc import Mapping, Sequence
from numbers import Integral
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from pymc_features import _checks as checks
from pymc_features._checks import require
from pymc_features.io.formats import read_source
from pymc_features.io.formats.libraries import is_source
from pymc_features.io.reading.labels import QUANTITIES, SI, sensitivity_of, unit_factor
from pymc_features.io.reading.recording import Request, chosen, in_si

if TYPE_CHECKING:
    import xarray as xr

OF_FILE = Request._fields.index("columns")  # what is said before it tells how a file is read
COMMON = "Sensors must have a common clock"
REACH = 10  # samples by which gaps are wider once a channel is moved to other times
#: What may be said of all sensors or of each on its own, and of each alone.
OF_ALL = "units", "quantity", "sensitivity", "dt", "clock", "clock_units", "skip", "wrapped"
OF_SENSOR = "file", "column", *OF_ALL, "fs", "scale", "delay", "anchors"


def read_channels(
    files: str | PathLike | Sequence[str | PathLike] | Mapping[str, str | PathLike],
    *,
    columns: int | str | Sequence[int | str] | Mapping[str, int | str] | None = None,
    units: str | float | None = None,
    dt: float | None = None,
    fs: float | None = None,
    clock: int | str | bool | None = None,
    clock_units: str | float | None = None,
    skip: int = 0,
    wrapped: bool | None = None,
    resample: float | None = None,
) -> "xr.DataArray":
    """Read measured accelerations of several sensors, aligned on their common clock, in m/s^2.

    Files, of one sensor or several each, are aligned by whole samples of their clocks and cut to the window
    they have in common; nothing else is changed.

    Parameters
    ----------
    files : path, sequence of paths, or mapping of sensor name to path or to a mapping
        Text (CSV, raw exports) or any format that `read_record` recognises; in place of a path a
        `pandas.DataFrame` with labels, an `xarray.DataArray` (sensor, time), an ObsPy `Stream`, or a list of
        dicts of SEP005 (`data`, `name`, `unit_str`, `fs` or `time`). List sensors from the base up. A mapping
        for a sensor has its `file` and any of `column`, `units`, `dt`, `fs`, `clock`, `clock_units`, `skip`,
        `wrapped`; `quantity` ("acceleration", "velocity", "displacement", "strain", "force" or "pressure");
        `sensitivity` of a voltage, such as "100 mV/g", or in V per SI unit; `scale`, a factor; `delay`, how
        late it comes [s]; `anchors`, two pairs of a reading of a clock that drifts and the true time [s].
    columns : int, str, sequence of them, or mapping of sensor name to column, optional
        Which columns of every file are accelerations, by index from 0 or header name, or which MATLAB
        variables; a matrix there is several sensors. All but the clock by default.
    units : str or float, optional
        "g" (9.81 m/s^2), "mg", "m/s^2", "cm/s^2", "mm/s^2", "gal", "in/s^2" or "ft/s^2", or m/s^2 per file
        unit, positive; where headers such as ``acc [g]``, or MATLAB's ``units``, do not state it.
    dt, fs : float, optional
        Sampling interval [s] or rate [Hz], positive; stated by the clock, or by MATLAB's ``dt`` or ``fs``.
    clock : int, str or False, optional
        Column or variable with the times; by default time stamps, or one called t, time, date and so on, else
        a first column that runs forward. False: there is none, the files start together.
    clock_units : str or float, optional
        Of the clock: "s", "ms", "us", "ns", "min", "h", "d" or seconds per count. Headers such as
        ``time [ms]`` state it; without a statement seconds, of SampleTimeFine microseconds.
    skip : int
        Rows left out at the start of every file, such as an empty first packet.
    wrapped : bool, optional
        As of `read_record`.
    resample : float, optional
        Sampling rate [Hz] of all sensors, for files of different rates: each is moved to the same times, as
        a band-limited history without what this rate cannot carry. Gaps are wider by 10 samples on each side.

    Returns
    -------
    xarray.DataArray (sensor, time)
        Accelerations [m/s^2] with coordinates `sensor`, the keys of `files` or `columns`, else file or column
        names, and `time` [s] from 0. `attrs`: `units`, and `start`, the clock at the first sample [s], since
        1970 where the file has dates. Of different quantities `quantity` and `units` are coordinates.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError, ImportError
        If there is no such file, it cannot be opened, or needs ObsPy, pyuff or npTDMS.
    ValueError, TypeError
        If an argument is not admissible or contradicts a file, a file is broken or no history of
        accelerations, its clock has gaps or uneven steps (see `read_channels_with_gaps`), the sensors have no
        common clock, or a channel is constant; the message names file and line.

    Warns
    -----
    ChannelWarning, UserWarning
        If a channel looks clipped or interrupted, is a copy of another or implausible in these units, if the
        first samples are empty, or the clocks are not simultaneous; if `dt` contradicts a file, or the times
        of a MiniSEED file its rate.

    Examples
    --------
    >>> import pandas as pd
    >>> table = pd.DataFrame({"time [s]": [0.00, 0.02, 0.04], "roof [g]": [0.0, 0.3, 0.1]})
    >>> read_channels(table).sel(sensor="roof").values
    array([0.   , 2.943, 0.981])
    """
    asked = Request(checks.step_or_rate(dt, fs), clock, clock_units, skip, wrapped, units=units)
    return _read(files, columns, checked(asked), resample)


def read_channels_with_gaps(
    files: str | PathLike | Sequence[str | PathLike] | Mapping[str, str | PathLike],
    *,
    columns: int | str | Sequence[int | str] | Mapping[str, int | str] | None = None,
    units: str | float | None = None,
    dt: float | None = None,
    fs: float | None = None,
    clock: int | str | bool | None = None,
    clock_units: str | float | None = None,
    skip: int = 0,
    wrapped: bool | None = None,
    resample: float | None = None,
) -> "xr.DataArray":
    """Read measured accelerations of several sensors of which samples are missing: NaN.

    Missing are cells of a text file that are empty or "nan", NaN in a MATLAB file, and rows that a clock
    passes over, all channels of that file at once.

    Parameters
    ----------
    files, columns, units, dt, fs, clock, clock_units, skip, wrapped, resample
        As of `read_channels`.

    Returns
    -------
    xarray.DataArray (sensor, time)
        As from `read_channels`, NaN in the gaps. A motion of the base must be without gaps.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError, ValueError, TypeError
        As from `read_channels`, which also says what is warned of; and if more samples are missing than there
        are, if the first row of numbers of a text file is not whole, or a row has no time.

    Examples
    --------
    >>> import pandas as pd
    >>> table = pd.DataFrame({"time [s]": [0.00, 0.02, 0.08], "base [m/s^2]": [0.1, 0.0, 0.2]})
    >>> read_channels_with_gaps(table).values
    array([[0.1, 0. , nan, nan, 0.2]])
    """
    asked = Request(checks.step_or_rate(dt, fs), clock, clock_units, skip, wrapped, gaps=True, units=units)
    return _read(files, columns, checked(asked), resample)


def checked(asked: Request) -> Request:
    """What the caller says of all files, or of the file of one sensor, checked."""
    checks.check_choice(asked.quantity, "quantity", QUANTITIES)
    if asked.wrapped is not None:
        checks.check_flag(asked.wrapped, "wrapped", "Leave it out for what the file shows.")
    if asked.clock is True:
        raise TypeError("`clock` must be a column, False or None, got True.")
    if asked.clock is False and asked.dt is None:
        raise ValueError(f"`dt` must be given with clock=False. {checks.SAMPLING_INTERVAL}")
    if asked.sensitivity is not None:
        sensitivity_of(asked.sensitivity, asked.quantity)
    clock, seconds = asked.clock, asked.clock_units
    return asked._replace(
        dt=None if asked.dt is None else checks.check_step(asked.dt),
        clock=clock if clock is None or clock is False else check_column(clock, "clock"),
        clock_units=None if seconds is None else unit_factor(seconds, "time", "clock_units"),
        skip=checks.check_integer(asked.skip, "skip", least=0, advice="It counts rows at the start."),
    )


def _read(files, columns, request: Request, resample) -> "xr.DataArray":
    """The channels of all files on their common clock, or band-limited at a rate [Hz]."""
    import xarray as xr  # a second to import

    from pymc_features.signals.channels import correct
    from pymc_features.signals.check import check_each

    if resample is not None:
        resample = checks.check_positive(resample, "resample", "Pass the sampling rate in Hz.")
    kept, names, measured, delays = {}, [], [], []
    for label, source, own in _sensors(files, columns, request, bool(resample)):
        said = Request(*own[:OF_FILE])
        key = id(source) if is_source(source) else str(source), said
        recording = kept[key] = kept.get(key) or read_source(source, said)
        found = chosen(recording, own.columns)
        names.append((label, [channel.name for channel in found]))
        histories = [in_si(channel, own, recording) for channel in found]
        apart = len({history.start for history in histories}) > 1
        for channel, history in zip(found, histories, strict=True):
            np.multiply(history.values, own.scale, out=history.values)
            if apart:
                history = history._replace(name=f"{recording.file} ({channel.name})")
            if own.anchors is not None:  # two readings whose true times are known
                (first, at_first), (last, at_last) = own.anchors
                ratio = (at_last - at_first) / (last - first)
                start = at_first + ratio * ((history.start or 0.0) - first)
                history = history._replace(dt=ratio * history.dt, start=start)
            measured.append(history)
            delays.append(own.delay)
    if any(delay is not None for delay in delays) and all(history.start is None for history in measured):
        measured = [history._replace(start=0.0) for history in measured]
    # a clock is set back by whole samples unless it is resampled, and its history moved by the rest
    late, steps = np.array([(by or 0.0, one.dt) for by, one in zip(delays, measured, strict=True)]).T
    whole = late if resample else steps * np.rint(late / steps)
    moved = zip(measured, whole.tolist(), strict=True)
    measured = [one if one.start is None else one._replace(start=one.start - by) for one, by in moved]
    values, step, start = _resampled(measured, resample) if resample else _aligned(measured)
    quantities = [history.quantity for history in measured]
    sensors = _sensor_names(names, files, columns)
    time = ("time", step * np.arange(values.shape[1]), {"units": "s"})
    coords, name = {"sensor": sensors, "time": time}, quantities[0]
    attrs = {"units": SI[quantities[0]], "start": start}
    if len(set(quantities)) > 1:
        coords |= {"quantity": ("sensor", quantities), "units": ("sensor", [SI[q] for q in quantities])}
        name, attrs = "measured", {"start": start}
    channels = xr.DataArray(values, coords, ("sensor", "time"), name=name, attrs=attrs)
    rest = {s: by for s, by in zip(sensors, (late - whole).tolist(), strict=True) if abs(by) > 1e-9 * step}
    channels = correct(channels, delay=rest) if rest else channels
    if (accelerations := np.array(quantities) == "acceleration").any():
        check_each(channels if accelerations.all() else channels[accelerations])
    return channels


def _aligned(channels: list) -> tuple[np.ndarray, float, float]:
    """Values (sensor, time) of the times that all channels have, by whole samples; step and start [s]."""
    from pymc_features.signals.channels import warn_channel

    first = channels[0]
    for channel in channels[1:]:
        n = min(first.values.size, channel.values.size)
        if abs(channel.dt - first.dt) * (n - 1) > 0.5 * first.dt:
            steps = f"{first.dt:.10g} s in {first.name} and {channel.dt:.10g} s in {channel.name}"
            raise ValueError(f"{COMMON}, the step is {steps}. Pass `resample`, the rate [Hz] of all.")
    starts, latest, _ = _common_span(channels)
    sizes = np.array([channel.values.size for channel in channels])
    if first.start is None:
        said = checks.listed([f"{channel.name} {channel.values.size}" for channel in channels])
        what = f"the same number of samples, got {said}. Cut them to the same window first."
        require(len(set(sizes)) == 1, f"Sensors without clocks must have {what}")
        return np.array([channel.values for channel in channels]), first.dt, 0.0
    dt = float(f"{np.mean([channel.dt for channel in channels]):.10g}")
    steps = int(np.rint((latest - first.start) / dt))  # of the first clock, to which the others are aligned
    start = first.start + steps * dt
    skipped = np.rint((start - starts) / dt).astype(int)
    n_times = (sizes - skipped).min()
    off = starts + skipped * dt - start
    different = {(c.name, c.values.size, by): c for c, by in zip(channels, off, strict=True)}
    for (name, size, late), channel in different.items():
        if abs(late) > 0.05 * dt + 2.0 * channel.quantum:
            said = f"its samples come {1e3 * abs(late):.3g} ms ({abs(late) / dt:.2g} samples)"
            said = f"{said} {'after' if late > 0.0 else 'before'} those of {first.name} by the clocks"
            said = f"{said}; they are taken as simultaneous. Pass `resample` if that matters."
            warn_channel(f"{name}: {said}")
        if n_times < 0.5 * size:
            said = f"only {n_times} of its {size} samples are in the window that all sensors have in common"
            warn_channel(f"{name}: {said}. Check for a file that starts late or ends early.")
    rows = [channel.values[k : k + n_times] for channel, k in zip(channels, skipped, strict=True)]
    return np.array(rows), dt, start


def _common_span(channels: list) -> tuple[np.ndarray, float, float]:
    """Starts [s], 0 without clocks, which all channels have or none; start and stop of their common time."""
    bare = [channel.name for channel in channels if channel.start is None]
    if bare and len(bare) < len(channels):
        said = "the column with the times, or clock=False and `dt` if all files start together."
        raise ValueError(f"{COMMON}, {bare[0]} has none and others do. Pass `clock`, {said}")
    starts = np.array([channel.start or 0.0 for channel in channels])
    stops = starts + [(channel.values.size - 1) * channel.dt for channel in channels]
    if stops.min() - starts.max() < 0.99 * channels[0].dt:
        spans = zip(channels, starts, stops, strict=True)
        ranges = dict.fromkeys(f"{c.name} {start:.6g} s to {stop:.6g} s" for c, start, stop in spans)
        said = f"these have no time in common: {checks.listed(list(ranges))}. Pass clock=False and `dt`"
        raise ValueError(f"{COMMON}, {said} if the files start together, or one event only.")
    return starts, float(starts.max()), float(stops.min())


def _resampled(channels: list, rate: float) -> tuple[np.ndarray, float, float]:
    """Values (sensor, time) at a common rate [Hz], each moved to the same times; step and start [s]."""
    from pymc_features import band_limited
    from pymc_features.signals.channels import filled, widened

    starts, start, stop = _common_span(channels)
    n_times = (stop - start) * rate * (1.0 + 1e-12) + 1.0
    what = f"a rate that makes 2 samples or more of the {stop - start:.4g} s that all have in common"
    require(2.0 <= n_times < checks.LARGEST_COUNT, checks.message("resample", what, f"{rate:g} Hz"))
    times = np.arange(int(n_times)) / rate
    found = []
    for begin, channel in zip(starts, channels, strict=True):
        whole, gaps = filled(channel.values)
        late = times + (start - begin)
        values = band_limited.at_times(whole[None], channel.dt, late, 1.0 / rate)[0]
        nearest = np.rint(late / channel.dt).astype(np.int64).clip(0, whole.size - 1)
        found.append(np.where(widened(gaps, REACH)[nearest], np.nan, values))
    return np.array(found), 1.0 / rate, start


def _sensors(files, columns, request: Request, resampled: bool) -> list[tuple[str, object, Request]]:
    """Name and source of each entry of `files`, and what is said of it."""
    picked = list(columns.values()) if isinstance(columns, Mapping) else checks.as_list(columns)
    picked = [columns] if picked is None and columns is not None else picked
    if isinstance(files, Mapping):
        names, sources = list(map(str, files)), list(files.values())
    else:
        sources = [files] if isinstance(files, str | PathLike) or is_source(files) else checks.as_list(files)
        if sources is None:
            what = "a path, several, or a mapping of sensor names to paths"
            raise TypeError(checks.message("files", what, checks.shown(files)))
        names = [None] * len(sources)
    for name, some in (("files", sources), ("columns", picked)):
        require(some != [], f"`{name}` must name at least one, got none.")
    request = request._replace(columns=picked and [check_column(column, "columns") for column in picked])
    found = []
    for name, source in zip(names, sources, strict=True):
        own = request
        if isinstance(source, Mapping):
            source, own = source.get("file"), _of_sensor(name, source, request, resampled)
        if name is None:
            name = "" if is_source(source) else checks.check_path(source, "files").stem
        found.append((name, source, own))
    return found


def _of_sensor(name, said: Mapping, request: Request, resampled: bool) -> Request:
    """What is said of the file of one sensor by a mapping."""
    unknown = [key for key in said if key not in OF_SENSOR]
    if unknown or "file" not in said:
        what = f"`file` and any of {', '.join(OF_SENSOR[1:])} of {name!r}"
        raise ValueError(checks.message("files", what, checks.listed(unknown or list(said))))
    own = request._replace(**{key: said[key] for key in OF_ALL if key in said})
    for key in [key for key in ("scale", "delay") if key in said]:
        own = own._replace(**{key: checks.check_number(said[key], key)})
        checks.check_finite(np.float64(said[key]), key)
    require(own.scale, f"`scale` must not be zero, got 0 for {name!r}. Leave the sensor out instead.")
    if "anchors" in said:
        require(resampled, f"`resample` must be given with `anchors` of {name!r}, got none. Pass it [Hz].")
        pairs = [checks.as_list(pair) or [] for pair in checks.as_list(said["anchors"]) or []]
        pairs = [[checks.check_number(value, "anchors") for value in pair] for pair in pairs]
        if [len(pair) for pair in pairs] != [2, 2] or not (np.diff(pairs, axis=0) > 0.0).all():
            what = "two pairs of a reading of the clock and its true time in seconds, the later second"
            raise ValueError(checks.message("anchors", what, checks.shown(said["anchors"])))
        own = own._replace(anchors=pairs)
    if "fs" in said:
        own = own._replace(dt=checks.step_or_rate(said.get("dt"), said["fs"]))
    if said.get("column") is not None:
        own = own._replace(columns=[check_column(said["column"], "column")])
    return checked(own)


def check_column(column, name: str) -> int | str:
    """The index or the name of a column."""
    value = checks.single(column)
    if not (isinstance(value, str) or (checks.is_number(value) and isinstance(value, Integral))):
        raise TypeError(checks.message(name, "an index or a name", checks.shown(column)))
    return value if isinstance(value, str) else int(value)


def _sensor_names(found, files, columns) -> list[str]:
    """One name for each channel: of its file, of its column, or of both where there are several of both."""
    names, named = [], isinstance(files, Mapping)
    keys = [str(name) for name in columns] if isinstance(columns, Mapping) else None
    for label, own in found:
        own = keys if keys is not None and len(keys) == len(own) else own
        if len(own) == 1 and label and (keys is None or named or len(found) > 1):
            names.append(label)
        else:
            alone = not label or (len(found) == 1 and not named)
            names += own if alone else [f"{label} {name}" for name in own]
    said = f"{checks.listed(names)}. Pass `files` or `columns` as a mapping of names."
    require(len(set(names)) == len(names), f"Sensors must have different names, got {said}")
    return names
