"""What a format of files is: how its first lines look, and what its readers return."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from pymc_features._checks import SAMPLING_INTERVAL, listed, shown
from pymc_features.io.reading.clock import Clock, MeasuredFile, Request, common_window
from pymc_features.io.reading.lines import decoded
from pymc_features.io.reading.units import resolve_dt, resolve_units, time_step, warn_user
from pymc_features.records import Record

OPENING = 16_384  # bytes


@dataclass(frozen=True)
class Opening:
    """The first bytes of a file, by which its format is recognised.

    Attributes
    ----------
    suffix : str
        Of the file name, in lower case.
    head : bytes
        At most `OPENING` of them.
    """

    suffix: str
    head: bytes

    @classmethod
    def of(cls, path: Path) -> "Opening":
        """Read the first bytes of a file."""
        with path.open("rb") as file:
            return cls(path.suffix.lower(), file.read(OPENING))

    @cached_property
    def lines(self) -> list[str]:
        """The first lines, without blanks at their ends; none if the file is no text."""
        text = decoded(self.head)
        return [] if "\0" in text else [line.rstrip() for line in text.split("\n")]

    @property
    def first(self) -> str:
        """The first line, in lower case."""
        return self.lines[0].lower() if self.lines else ""


@dataclass(frozen=True)
class Channel:
    """One channel of a recording, as its file states it; None where the file is silent.

    Attributes
    ----------
    name : str
        Direction or number of the channel.
    values : ndarray (time,)
        Accelerations, in `units`.
    units : str or None
        What the file says of them, "g" for example.
    dt : float or None
        Sampling interval [s].
    times : ndarray (time,) or None
        Times of the values [s], where they are uneven; `dt` is None then.
    start : float or None
        Time of the first sample [s], on a clock that files of this format share.
    problem : str
        Why its values cannot be taken, if it is asked for.
    """

    name: str
    values: np.ndarray
    units: str | None = None
    dt: float | None = None
    times: np.ndarray | None = None
    start: float | None = None
    problem: str = ""


@dataclass(frozen=True)
class Format:
    """A kind of files: what it is called, how it is recognised, what it states.

    Attributes
    ----------
    name : str
        What messages and the table of formats call it.
    recognises : callable
        `Opening` -> whether the file is of this format.
    files : str
        Usual endings of file names, for the table of formats.
    states : str
        What its files say themselves, for the table of formats.
    """

    name: str
    recognises: Callable[[Opening], bool]
    files: str
    states: str

    def record(self, path: Path, request: Request) -> Record:
        """One acceleration series; `request.columns` has at most one entry."""
        raise NotImplementedError

    def channels(self, path: Path, request: Request) -> MeasuredFile:
        """All series that are asked for, on their common clock."""
        raise NotImplementedError


@dataclass(frozen=True)
class RecordedFormat(Format):
    """A format whose files hold the channels of one recording.

    Attributes
    ----------
    read : callable
        path -> (channels, name of the recording or None); it raises `ValueError` with the file's name.
    """

    read: Callable[[Path], tuple[Sequence[Channel], str | None]]

    def record(self, path: Path, request: Request) -> Record:
        found, name = self._read(path)
        asked = request.columns
        if asked is None and len(found) > 1:
            raise ValueError(
                f"`column` must be given, {path.name} ({self.name}) has the channels {_listed(found)}. "
                "Pass the name or the index (from 0) of one."
            )
        channel = found[0] if asked is None else _find(found, asked[0], "column", path.name)
        [values], dt = _even([channel], request, path.name)
        return Record(values, dt, name=name or path.stem)

    def channels(self, path: Path, request: Request) -> MeasuredFile:
        found, _ = self._read(path)
        if request.columns is not None:
            found = [_find(found, column, "columns", path.name) for column in request.columns]
        rows, dt = _even(found, request, path.name)
        start = found[0].start if request.clock is not False else None
        if start is not None and any(channel.start != start for channel in found):
            own = zip(found, rows, strict=True)
            clocks = [Clock(f"{path.name} ({c.name})", row.size, dt, c.start) for c, row in own]
            window = common_window(clocks)
            rows = [row[k : k + window.n_times] for row, k in zip(rows, window.first, strict=True)]
            start = window.start
        if len({row.size for row in rows}) > 1:
            raise ValueError(
                f"`columns` must name channels of the same number of samples, those of {path.name} have "
                f"{listed([row.size for row in rows])}. Read them one by one."
            )
        values = np.array(rows)[:, request.skip :]
        start = None if start is None else start + request.skip * dt
        names = [path.stem] if len(found) == 1 and request.columns is None else [c.name for c in found]
        return MeasuredFile(names, values, Clock(path.name, values.shape[1], dt, start))

    def _read(self, path: Path) -> tuple[list[Channel], str | None]:
        """Channels and name; no file of this format leaves the library with another error than ours."""
        try:
            found, name = self.read(path)
        except (ArithmeticError, LookupError, MemoryError, TypeError, UnicodeError) as error:
            raise ValueError(
                f"{path.name} must be a whole {self.name} file, it cannot be read ({error}). "
                "Fetch the file again."
            ) from error
        if not found:
            raise ValueError(f"{path.name} ({self.name}) must hold an acceleration, none was found.")
        return list(found), name


def _listed(channels: Sequence[Channel]) -> str:
    return listed([channel.name for channel in channels])


def _find(channels: Sequence[Channel], column, argument: str, file: str) -> Channel:
    """A channel by its name or index."""
    if isinstance(column, str):
        matches = [channel for channel in channels if channel.name.lower() == column.strip().lower()]
    else:
        matches = list(channels[column : column + 1]) if column >= 0 else []
    if len(matches) != 1:
        raise ValueError(
            f"`{argument}` must be one of the channels of {file} ({_listed(channels)}), got {shown(column)}. "
            "Pass the index (from 0) or the name of one."
        )
    return matches[0]


def _even(channels: Sequence[Channel], request: Request, file: str) -> tuple[list[np.ndarray], float]:
    """Histories (time,) [m/s^2] of channels at one even step [s], and the step."""
    for problem in (channel.problem for channel in channels if channel.problem):
        raise ValueError(problem)
    steps = {_stated_step(channel, request, file) for channel in channels}
    if len(steps) > 1:
        raise ValueError(
            f"`columns` must name channels with one step, {_listed(channels)} of {file} have "
            f"steps of {listed([f'{step} s' for step in sorted(steps, key=str)])}. Read them one by one."
        )
    dt = resolve_dt(request.dt, steps.pop(), file)
    rows = []
    for channel in channels:
        factor = resolve_units(request.units, channel.units, file)
        values = channel.values if channel.times is None else _interpolated(channel, dt, file)
        missing = np.flatnonzero(np.isnan(values))
        if missing.size and not request.gaps:
            raise ValueError(
                f"{file}, {channel.name}: no samples may be missing, {missing.size} are, the first after "
                f"{dt * missing[0]:.6g} s. Cut the file to one side, or use `read_channels_with_gaps`."
            )
        if values.size < 2 or np.isinf(values).any():
            raise ValueError(f"{file}, {channel.name}: at least 2 finite samples must be there, got others.")
        rows.append(factor * values)
    return rows, dt


def _stated_step(channel: Channel, request: Request, file: str) -> float | None:
    """Step [s] of a channel; of uneven times the one that the caller asks for."""
    if channel.times is None:
        return channel.dt
    if request.dt is None:
        raise ValueError(
            f"`dt` must be given, the times of {file} ({channel.name}) are uneven, "
            f"{float(np.diff(channel.times).mean()):.3g} s apart on average. {SAMPLING_INTERVAL} The values "
            "are joined by straight lines and read off at this step."
        )
    return request.dt


def even_or_times(times: np.ndarray, quantum: float, where: Callable[[int], str]) -> dict:
    """The arguments `dt` or `times` of a `Channel` with printed times [s], of resolution `quantum` [s]."""
    if not (np.diff(times) > 0.0).all():
        row = int(np.argmax(np.diff(times) <= 0.0)) + 1
        raise ValueError(
            f"{where(row)}: time must increase, it goes from {times[row - 1]:g} s to {times[row]:g} s. "
            "Fetch the file again."
        )
    try:
        return {"dt": time_step(times, where, quantum)}
    except ValueError:
        return {"times": times}


def _interpolated(channel: Channel, dt: float, file: str) -> np.ndarray:
    """Values (time,) at an even step, on straight lines between those of the file."""
    times = channel.times - channel.times[0]
    n_times = int(times[-1] / dt * (1.0 + 1e-12)) + 1
    if n_times > 100 * times.size:
        raise ValueError(
            f"`dt` must not be a hundredth of the steps of {file}, got {dt:g} s for {times.size} values in "
            f"{times[-1]:g} s. {SAMPLING_INTERVAL}"
        )
    values = np.interp(dt * np.arange(n_times), times, channel.values)
    before, after = np.abs(channel.values).max(), np.abs(values).max(initial=0.0)
    if after < 0.99 * before:
        warn_user(
            f"{file} ({channel.name}): at dt={dt:g} s the peak of its uneven values falls from {before:.4g} "
            f"to {after:.4g} {channel.units}. Pass a smaller `dt`."
        )
    return values
