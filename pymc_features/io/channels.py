"""Measured channels of several sensors, from one file or a group of files, on their common clock."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Integral
from os import PathLike
from pathlib import Path

import numpy as np
import xarray as xr

from pymc_features._checks import (
    SAMPLING_INTERVAL,
    as_list,
    check_flag,
    check_integer,
    check_path,
    check_step,
    is_number,
    listed,
    message,
    shown,
    single,
)
from pymc_features.io.formats import format_of
from pymc_features.io.reading.clock import Request, clock_seconds, common_window
from pymc_features.io.reading.lines import check_readable
from pymc_features.io.reading.units import unit_factor
from pymc_features.signals.single import check_each


def read_channels(
    files: str | PathLike | Sequence[str | PathLike] | Mapping[str, str | PathLike],
    *,
    columns: int | str | Sequence[int | str] | Mapping[str, int | str] | None = None,
    units: str | float | None = None,
    dt: float | None = None,
    clock: int | str | bool | None = None,
    clock_units: str | float | None = None,
    skip: int = 0,
    wrapped: bool | None = None,
) -> xr.DataArray:
    """Read measured accelerations of several sensors, aligned on their common clock, in m/s^2.

    One file with several columns, or one file for each sensor. Files are aligned by whole samples of their
    clocks and cut to the window they have in common; nothing else is changed.

    Parameters
    ----------
    files : path, sequence of paths or mapping of sensor name to path
        Text (raw exports with any lines above the numbers, CSV), MATLAB (``.mat``) or any format that
        `read_record` recognises. List sensors from the base up.
    columns : int, str, sequence of them, or mapping of sensor name to column, optional
        Which columns of every file are accelerations, by index from 0 or header name, or which MATLAB
        variables; a matrix there is several sensors. All but the clock by default.
    units : str or float, optional
        "g" (9.81 m/s^2), "mg", "m/s^2", "cm/s^2", "mm/s^2", "gal", "in/s^2" or "ft/s^2", or m/s^2 per file
        unit, positive; needed where headers such as ``acc [g]``, or a MATLAB text variable ``units``, do not
        state it.
    dt : float, optional
        Sampling interval [s], positive; stated by the clock, or by MATLAB's ``dt`` or ``fs`` [Hz].
    clock : int, str or False, optional
        Column or variable with the times; by default time stamps, or one called t, time, timestamp, date,
        elapsed or SampleTimeFine, else a first column that runs forward. False: there is none, the files
        start together.
    clock_units : str or float, optional
        Of the clock: "s", "ms", "us", "ns", "min", "h" or seconds per count. Headers such as ``time [ms]``
        state it; without a statement seconds, of SampleTimeFine microseconds.
    skip : int
        Rows left out at the start of every file, such as an empty first packet.
    wrapped : bool, optional
        Text only: True if one series runs along the lines, False if each column is a series. Needed where
        neither labels nor a clock tell.

    Returns
    -------
    xarray.DataArray (sensor, time)
        Accelerations [m/s^2] with coordinates `sensor`, the keys of `files` or `columns`, else file or column
        names, and `time` [s] from 0. `attrs`: `units`, and `start`, the clock at the first sample [s].

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError
        If there is no such file or it cannot be opened.
    ValueError, TypeError
        If an argument is not admissible or contradicts a file, a file is broken or no history of
        accelerations, its clock has gaps or uneven steps (see `read_channels_with_gaps`), the sensors have no
        common clock, or a channel is constant; the message names file and line.

    Warns
    -----
    ChannelWarning
        If a channel looks clipped or interrupted, is a copy of another or implausible in these units, if the
        first samples are empty, or the clocks are not simultaneous. `signals.check_channels` compares the
        sensors.
    UserWarning
        If `dt` contradicts a file, or the times of a MiniSEED file its rate.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "frame.csv"
    ...     _ = path.write_text("time [s],base [g],roof [g]\\n0.00,0.1,0.0\\n0.02,0.0,0.3\\n0.04,-0.2,0.1\\n")
    ...     read_channels(path).sel(sensor="roof").values
    array([0.   , 2.943, 0.981])
    """
    return _read(files, columns, _request(units, dt, clock, clock_units, skip, wrapped))


def read_channels_with_gaps(
    files: str | PathLike | Sequence[str | PathLike] | Mapping[str, str | PathLike],
    *,
    columns: int | str | Sequence[int | str] | Mapping[str, int | str] | None = None,
    units: str | float | None = None,
    dt: float | None = None,
    clock: int | str | bool | None = None,
    clock_units: str | float | None = None,
    skip: int = 0,
    wrapped: bool | None = None,
) -> xr.DataArray:
    """Read measured accelerations of several sensors of which samples are missing: NaN.

    Missing are cells of a text file that are empty or "nan", NaN in a MATLAB file, and rows that a clock
    passes over, all channels of that file at once.

    Parameters
    ----------
    files, columns, units, dt, clock, clock_units, skip, wrapped
        As of `read_channels`.

    Returns
    -------
    xarray.DataArray (sensor, time)
        As from `read_channels`, NaN in the gaps. Functions of `signals` and the feature likelihoods take it,
        a motion of the base must be without gaps.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError, ValueError, TypeError
        As from `read_channels`; also if more samples are missing than there are, if the first row of numbers
        of a text file is not whole, or a row has no time.

    Warns
    -----
    ChannelWarning, UserWarning
        As `read_channels`.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "frame.csv"
    ...     rows = "0.00,0.1,0.0\\n0.02,0.0,\\n0.04,-0.2,0.1\\n0.08,0.1,0.2\\n"
    ...     _ = path.write_text("time [s],base [m/s^2],roof [m/s^2]\\n" + rows)
    ...     read_channels_with_gaps(path).values
    array([[ 0.1,  0. , -0.2,  nan,  0.1],
           [ 0. ,  nan,  0.1,  nan,  0.2]])
    """
    request = _request(units, dt, clock, clock_units, skip, wrapped)
    return _read(files, columns, replace(request, gaps=True))


def _request(units, dt, clock, clock_units, skip, wrapped) -> Request:
    """The settings of the caller, checked."""
    request = Request(
        units=units,
        dt=None if dt is None else check_step(dt),
        clock=_checked_clock(clock, dt),
        clock_units=None if clock_units is None else clock_seconds(clock_units),
        skip=check_integer(skip, "skip", least=0, advice="It counts rows at the start."),
        wrapped=wrapped,
    )
    check_wrapped(wrapped)
    if units is not None:
        unit_factor(units)
    return request


def _read(files, columns, request) -> xr.DataArray:
    """The channels of all files on their common clock."""
    paths, labels = _named_paths(files)
    keys, picked = _named_columns(columns)
    request, found = replace(request, columns=picked), []
    for path in paths:
        check_readable(path, "files")
        found.append(format_of(path, request).channels(path, request))
    window = common_window([file.clock for file in found])
    values = [file.values[:, k : k + window.n_times] for file, k in zip(found, window.first, strict=True)]
    channels = xr.DataArray(
        np.concatenate(values),
        dims=("sensor", "time"),
        coords={
            "sensor": _sensor_names(found, labels, keys, isinstance(files, Mapping)),
            "time": ("time", window.dt * np.arange(window.n_times), {"units": "s"}),
        },
        name="acceleration",
        attrs={"units": "m/s^2", "start": window.start},
    )
    check_each(channels)
    return channels


def _named_paths(files) -> tuple[list[Path], list[str]]:
    """Paths, and what each is called."""
    if isinstance(files, str | PathLike):
        files = [files]
    if isinstance(files, Mapping):
        paths, labels = [check_path(path, "files") for path in files.values()], [str(name) for name in files]
    elif (listed := as_list(files)) is not None:
        paths = [check_path(path, "files") for path in listed]
        labels = [path.stem for path in paths]
    else:
        what = "a path, several, or a mapping of sensor names to paths"
        raise TypeError(message("files", what, shown(files)))
    if not paths:
        raise ValueError("`files` must name at least one file, got none.")
    return paths, labels


def _named_columns(columns) -> tuple[list[str] | None, list | None]:
    """Names of the sensors where they are given, and the columns."""
    if columns is None:
        return None, None
    if isinstance(columns, Mapping):
        names, picked = [str(name) for name in columns], list(columns.values())
    else:
        listed = as_list(columns)
        names, picked = None, [columns] if listed is None else listed
    if not picked:
        raise ValueError("`columns` must name at least one column, got none.")
    return names, [check_column(column, "columns") for column in picked]


def check_column(column, name: str) -> int | str:
    """The index or the name of a column."""
    value = single(column)
    if not (isinstance(value, str) or (is_number(value) and isinstance(value, Integral))):
        raise TypeError(message(name, "an index or a name", shown(column)))
    return value if isinstance(value, str) else int(value)


def check_wrapped(wrapped) -> None:
    """Refuse what is not True, False or None."""
    if wrapped is not None:
        check_flag(wrapped, "wrapped", "Leave it out for what the file shows.")


def _checked_clock(clock, dt) -> int | str | bool | None:
    if clock is True:
        raise TypeError("`clock` must be a column, False or None, got True.")
    if clock is False and dt is None:
        raise ValueError(f"`dt` must be given with clock=False. {SAMPLING_INTERVAL}")
    return clock if clock is None or clock is False else check_column(clock, "clock")


def _sensor_names(found, labels, keys, named: bool) -> list[str]:
    """One name for each channel: of its file, of its column, or of both where there are several of both."""
    names = []
    for file, label in zip(found, labels, strict=True):
        own = keys if keys is not None and len(keys) == len(file.names) else file.names
        if len(own) == 1 and (keys is None or named or len(found) > 1):
            names.append(label)
        else:
            names += own if len(found) == 1 and not named else [f"{label} {name}" for name in own]
    if len(set(names)) < len(names):
        raise ValueError(
            f"Sensors must have different names, got {listed(names)}. Pass `files` or `columns` as a "
            "mapping of names."
        )
    return names
