"""Recordings, which every reader makes: channels as a file states them, and as the caller wants them."""

import re
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pymc_features._checks import SAMPLING_INTERVAL, listed, require, shown, warn_caller
from pymc_features.io.reading.labels import NO_HISTORY, Label, resolve_dt, resolve_units, role_of, unit_of
from pymc_features.io.reading.lines import GZIP, decoded

OPENING = 16_384  # bytes
GZIP_BITS = 31  # of zlib, for the header of gzip
TINY, ALONE = 1e-60, 1e3  # over the largest value, and the largest over the second: none is measured so
FEWEST = 10  # values among which one can be told
#: Seconds per count of the microsecond counter in exports of Movella (Xsens) DOT sensors, by its label.
COUNTERS = {"sampletimefine": 1e-6}
DAYS = (2e4, 8e4), (7e5, 8e5)  # of spreadsheets and of MATLAB, in the years 1954 to 2119 and 1916 to 2190
SECONDS = 'Pass "s", "ms", "us", "d" or the seconds per count'


class Request(NamedTuple):
    """What the caller says about every file; None leaves it to the file."""

    dt: float | None = None
    clock: str | int | bool | None = None  # False: no clock
    clock_units: float | None = None  # [s] per count
    skip: int = 0
    wrapped: bool | None = None  # whether one series runs along the lines of a text file
    gaps: bool = False  # whether samples may be missing: NaN, empty cells, rows that a clock passes over
    columns: list | None = None  # from here on what makes no difference to how a file is read
    units: str | float | None = None
    quantity: str = "acceleration"
    sensitivity: str | float | None = None
    scale: float = 1.0
    delay: float | None = None  # how late it comes [s]
    anchors: list | None = None  # two pairs of a reading of the clock and the true time [s]


@dataclass(frozen=True)
class Opening:
    """The first bytes of a file, by which its format is recognised."""

    suffix: str  # of its name, in lower case
    head: bytes  # at most `OPENING` of them

    @classmethod
    def of(cls, path: Path) -> "Opening":
        """Read the first bytes of a file."""
        with path.open("rb") as file:
            head = file.read(OPENING)
        if not head.startswith(GZIP):
            return cls(path.suffix.lower(), head)
        with suppress(zlib.error):  # which whoever reads it will meet, and say
            head = zlib.decompressobj(GZIP_BITS).decompress(head, OPENING)
        return cls(Path(path.stem).suffix.lower(), head)

    @cached_property
    def lines(self) -> list[str]:
        """The first lines, without blanks at their ends; none if the file is no text."""
        text = decoded(self.head)
        return [] if "\0" in text else [line.rstrip() for line in text.split("\n")]

    def begins(self, how: "bytes | str | Callable[[Opening], bool]") -> bool:
        """Whether a pattern of bytes, one of the suffix or of lines in lower case, or a function says so."""
        if callable(how):
            return how(self)
        texts = [self.head] if isinstance(how, bytes) else [self.suffix, "\n".join(self.lines[:30]).lower()]
        return any(re.match(how, text) for text in texts)


class Channel(NamedTuple):
    """One channel of a recording, as its file states it; None where the file is silent."""

    name: str  # direction or number of the channel, label of the column
    values: np.ndarray  # (time,), in `unit`
    unit: str | None = None  # as the file says it, "g" for example
    dt: float | None = None  # sampling interval [s]
    times: np.ndarray | None = None  # (time,) [s], where they are uneven; `dt` is None then
    start: float | None = None  # time of the first sample [s], on a clock that files of this format share
    quantum: float = 0.0  # resolution of the times [s]
    quantity: str | None = None  # what it is, where more than a label says it
    label: str = ""  # what it is called besides: the header with its unit, the variable that it is a row of
    hidden: bool = False  # whether it is no measurement unless it is asked for: a clock, numbers of samples
    problem: str = ""  # why its values cannot be taken, if it is asked for

    @staticmethod
    def spacing(times: np.ndarray, quantum: float, where: Callable[[int], str]) -> dict:
        """The fields `dt` or `times` by printed times [s], of resolution `quantum` [s]."""
        try:
            return {"dt": even_clock(times, where, quantum)[0]}
        except ValueError:
            if not (np.diff(times) > 0.0).all():
                raise
            return {"times": times}


class Recording(NamedTuple):
    """What a file holds."""

    file: str  # what messages call it
    channels: Sequence[Channel]
    name: str | None = None  # by the file: event or station
    question: str = ""  # what is to be asked unless the caller names the channels
    skipped: bool = False  # whether the first samples are left out already, before the clock was looked at


class Format(NamedTuple):
    """A kind of files."""

    name: str
    files: str  # usual endings of file names
    states: str  # what its files say themselves
    begins: bytes | str | Callable[[Opening], bool]  # see `Opening`
    read: Callable[[Path, Request], Recording]  # its errors have the name of the file


def chosen(recording: Recording, columns: list | None, argument: str = "columns") -> list[Channel]:
    """The channels, or all rows of a variable, that the caller names; by default all measurements."""
    channels, hint = recording.channels, "Pass the index (from 0) or the name of one."
    of = f"of {recording.file} ({named(channels)})"
    if recording.question and not (columns and all(isinstance(column, str) for column in columns)):
        raise ValueError(recording.question)
    found = [channel for channel in channels if not channel.hidden] if columns is None else []
    for column in columns or ():
        matches, rows = [], False
        if isinstance(column, str):
            word = column.strip()
            matches = [c for c in channels if word in (c.name, c.label)]
            matches = matches or [c for c in channels if word.lower() in (c.name.lower(), c.label.lower())]
            rows = len({c.label for c in matches}) == 1 and matches[0].label != matches[0].name
            if rows:  # of a variable, without its clock
                matches = [channel for channel in matches if not channel.hidden] or matches
        elif column >= 0:
            matches = channels[column : column + 1]
        is_one = len(matches) == 1 or rows
        require(is_one, f"`{argument}` must be one of the channels {of}, got {shown(column)}. {hint}")
        found += matches
    require(found, f"`{argument}` must name a channel {of}, none is a measurement by its label. {hint}")
    return found


def named(channels: Sequence[Channel]) -> str:
    """Channels as a message lists them."""
    return listed([f"{c.name} [{c.unit}]" if c.unit else c.name for c in channels])


def in_si(channel: Channel, request: Request, recording: Recording) -> Channel:
    """A channel in SI units at an even step, which messages call by its file."""
    require(not channel.problem, channel.problem)
    file, skip = recording.file, 0 if recording.skipped else request.skip
    dt = resolve_dt(channel, request, file)
    factor = resolve_units(channel, request, file)
    values = (channel.values if channel.times is None else _interpolated(channel, dt, file))[skip:]
    sizes = np.abs(values)
    largest = np.nanmax(sizes, initial=0.0)
    if (missing := np.isinf(values) if request.gaps else ~np.isfinite(values)).any():
        at = missing.argmax()
        said = f"{missing.sum()} are, the first after {dt * at:.6g} s ({values[at]})"
        advice = "Cut the file to one side, or use `io.read_channels_with_gaps`."
        raise ValueError(f"{file}, {channel.name}: no samples may be missing, {said}. {advice}")
    require(values.size > 1, f"{file}, {channel.name}: at least 2 samples must be there, got {values.size}.")
    # a number of quite another size has a digit too many or too few in its exponent
    least = sizes.min(where=sizes > 0.0, initial=np.inf)
    alone = np.count_nonzero(sizes >= largest / ALONE) == 1
    odd = largest if alone else least if least < TINY * largest else 0.0
    if odd and np.count_nonzero(sizes > 0.0) >= FEWEST:
        what = f"a value of {odd:.4g} is of another size than others. Is its exponent spoilt?"
        warn_caller(f"{file}, {channel.name}: {what}")
    start = None if channel.start is None or request.clock is False else channel.start + skip * dt
    return channel._replace(name=file, values=factor * values, dt=dt, start=start, quantity=request.quantity)


def even_clock(
    times: np.ndarray, where: Callable, quantum: float = 0.0, gaps: bool = False, dt: float | None = None
) -> tuple[float | None, np.ndarray]:
    """Sampling interval [s] of a clock (time,), None if it is uneven and the caller's; numbers of samples."""
    steps = np.diff(times)
    if not (steps > 0.0).all():
        row = int(np.argmin(steps > 0.0)) + 1
        said = f"time must increase, it goes from {times[row - 1]:.10g} s to {times[row]:.10g} s"
        other = "name the column with the times by `clock`, or the acceleration by `column` and pass `dt`."
        raise ValueError(f"{where(row)}: {said}. Cut the file there; if this is no time, {other}")
    long = 1.5 * (steps.min() if steps.max() < 1.5 * steps.min() else np.median(steps))
    usual = float(steps[steps < long].mean())  # of printed times no step is exact
    missing = np.rint(steps / usual)
    off, slack = np.abs(steps - missing * usual), 0.1 * usual + 2.0 * quantum
    whole = (off <= 0.1 * usual).all() or (slack < 0.4 * usual and (off <= slack * missing).all())
    numbers, wide = np.arange(times.size), missing > 1.0
    if wide.any() and whole:
        if not gaps or missing.sum() >= 2.0 * times.size:
            row = int(wide.argmax()) + 1
            counts = f"{int((missing - 1.0).sum())} are, in {wide.sum()} gap(s)"
            first = f"from {times[row - 1]:.10g} s to {times[row]:.10g} s at a step of {usual:.4g} s"
            said = f"no samples may be missing, {counts}, the first {first}"
            raise ValueError(f"{where(row)}: {said}. Cut the file to one side, or fill the gap.")
        numbers = np.append(0, np.cumsum(missing.astype(np.int64)))
    mean = (times[-1] - times[0]) / numbers[-1]
    # rounding cannot make steps uneven that are multiples of the resolution, `quantum` [s]
    tolerance = 1e-3 * mean + 4.0 * np.spacing(np.abs(times).max())
    multiple = quantum > 0.0 and abs(mean / quantum - round(mean / quantum)) < 1e-6
    if quantum <= mean / 4.0 and not multiple:
        tolerance += quantum
    if np.abs(times - times[0] - mean * numbers).max() > tolerance:
        row = int(np.argmax(np.abs(steps - np.median(steps)))) + 1
        vary = f"they vary from {steps.min():.4g} s to {steps.max():.4g} s"
        text = f"{where(row)}: time steps must be even, {vary}"
        if dt is None:
            raise ValueError(f"{text}. Resample the record first.")
        warn_caller(f"{text}. The argument dt={dt:g} s is used.")
        return None, numbers
    return float(f"{mean:.10g}"), numbers


def _interpolated(channel: Channel, dt: float, file: str) -> np.ndarray:
    """Values (time,) at an even step, on straight lines between those of the file."""
    times = channel.times - channel.times[0]
    n_times = int(times[-1] / dt * (1.0 + 1e-12)) + 1
    what = f"got {dt:g} s for {times.size} values in {times[-1]:g} s. {SAMPLING_INTERVAL}"
    require(n_times <= 100 * times.size, f"`dt` must not be a hundredth of the steps of {file}, {what}")
    values = np.interp(dt * np.arange(n_times), times, channel.values)
    before, after = np.abs(channel.values).max(), np.abs(values).max(initial=0.0)
    if after < 0.99 * before:
        said = f"the peak of its uneven values falls from {before:.4g} to {after:.4g} {channel.unit}"
        warn_caller(f"{file} ({channel.name}): at dt={dt:g} s {said}. Pass a smaller `dt`.")
    return values


class Columns(NamedTuple):
    """Numbers with labels above them."""

    file: str  # what messages call it
    labels: list[Label]  # of each column; without a text where the file has none
    values: np.ndarray  # (row, column), NaN where a cell is empty
    where: Callable[[int, int], str]  # how a message calls the place of a row and a column
    resolution: Callable[[int], float] = lambda index: 0.0  # of the printed or stored numbers of a column
    own: bool = True  # whether the labels are more than words of a title
    stamp: int | None = None  # the column that was time stamps: seconds since `origin`
    origin: float = 0.0  # midnight of the first day [s since 1970], 0 of time stamps without dates
    units: str | None = None  # stated for all columns
    dt: float | None = None  # stated besides a clock [s]


def recording_of(columns: Columns, request: Request, question: str = "") -> Recording:
    """The channels of a table on its clock; the clock and numbers of samples are hidden among them."""
    timer = clock_column(columns, request.clock)
    place, numbers = _clock(columns, timer, request)
    values, problem = columns.values.T, f"`columns` must name measurements, column {timer} is the clock."
    if values.shape[1] <= numbers[-1]:
        values = np.full((len(values), numbers[-1] + 1), np.nan)
        values[:, numbers] = columns.values.T
    channels = []
    for index, (label, row) in enumerate(zip(columns.labels, values, strict=True)):
        is_time = role_of(label.name) == "time" and (unit_of(label.unit) is None or label.seconds)
        is_number = role_of(label.name) == "number" and label.unit is None
        name, unit = label.name or f"column {index}", label.unit or columns.units
        channels.append(Channel(name, row, unit, **place, label=label.text, hidden=is_time or is_number))
    if timer is not None:
        channels[timer] = channels[timer]._replace(problem=problem, hidden=True)
    return Recording(columns.file, channels, question=question, skipped=True)


def clock_column(columns: Columns, clock) -> int | None:
    """Index of the column with the times: as asked, by its label, or a first column that runs forward."""
    if clock is False:
        return None
    if clock is not None:
        texts = [label.text for label in columns.labels]
        asked = clock.strip() if isinstance(clock, str) else clock
        matches = {k for k, label in enumerate(columns.labels) if asked in (k, label.text, label.name)}
        known = listed(texts) if any(texts) else f"0 to {len(texts) - 1}"
        said = f"got {shown(clock)}. Pass the index (from 0) or the header name of the times."
        require(len(matches) == 1, f"`clock` must be one of the columns of {columns.file} ({known}), {said}")
        return matches.pop()
    if columns.stamp is not None:
        return columns.stamp
    roles = [role_of(label.name) for label in columns.labels]
    for role, label in zip(roles, columns.labels, strict=True):
        if role == "spectral" or (role in NO_HISTORY and label is columns.labels[0]):
            ways = "pass clock=False with `dt` and `columns`, or `clock`, the column with the times"
            other = "Read frequency response functions by `io.read_frequency_response`."
            said = f"got a column {label.text!r}. If it is one, {ways}. {other}"
            raise ValueError(f"{columns.file} must be a history over time, {said}")
    if "time" in roles:
        return roles.index("time")
    first, is_time = columns.labels[0], columns.labels[0].seconds is not None
    is_open = is_time or not columns.own or roles[0] in (None, "number")
    forward = len(columns.labels) > 1 and is_open and (np.diff(columns.values[:, 0]) > 0.0).mean() > 0.9
    if forward and first.text and roles[0] is None and not is_time and columns.own:
        said = f"does not say whether {first.text!r}, which runs forward, is the time"
        advice = "Call it time, or pass clock=False with `dt` and `columns`."
        raise ValueError(f"`clock` must be given, {columns.file} {said}. {advice}")
    return 0 if forward else None


def _clock(columns: Columns, timer: int | None, request: Request) -> tuple[dict, np.ndarray]:
    """Step, start and resolution of the clock, and the numbers of the samples (row,)."""
    file, numbers = columns.file, np.arange(columns.values.shape[0])
    if timer is None:
        return {"dt": columns.dt}, numbers
    readings, label, asked = columns.values[:, timer], columns.labels[timer], request.clock_units
    if not (there := np.isfinite(readings)).all():
        where = columns.where(int(there.argmin()), timer)
        raise ValueError(f"{where}: the clock must have a time in every row, got none. Cut the row.")
    known, stated = unit_of(label.unit), 1.0 if timer == columns.stamp else label.seconds
    if asked is not None and known is not None and not np.isclose(known.factor, asked, rtol=1e-6):
        said = f"got {asked:g} s. Leave it out, or correct the file."
        raise ValueError(f"`clock_units` must be those of the file, {file} states {label.text!r}, {said}")
    if asked is None and label.unit is not None and not stated:
        said = f"{file} states {label.unit!r} of its clock, which is no known unit of time"
        raise ValueError(f"`clock_units` must be given, {said}. {SECONDS}.")
    since_1970 = (unit for unit in (1e-3, 1e-6, 1e-9) if 1e9 <= unit * readings[0] < 4e9)  # from 2001 on
    stated = asked or stated or COUNTERS.get(label.name.lower()) or next(since_1970, None)
    scale = stated or 1.0
    for index, other in enumerate(columns.labels):  # each channel may have times of its own
        is_time = role_of(other.name) == "time" and other.seconds is not None
        if request.clock is None and index != timer and is_time:
            apart = other.seconds * columns.values[:, index] - scale * readings
            if abs(apart[0]) > scale * np.ptp(readings):
                apart = apart - apart[0]  # one is since the start, the other of the day
            if np.nanmax(np.abs(apart)) > 0.5 * scale * np.nanmedian(np.diff(readings)):
                said = f"{file} has {label.text!r} and {other.text!r}, which run apart"
                advice = "Read the channels of each clock by themselves, by `clock` and `columns`."
                raise ValueError(f"`clock` must be given, {said}. {advice}")
    quantum = scale * columns.resolution(timer)
    times = scale * readings
    step, numbers = even_clock(times, lambda k: columns.where(k, timer), quantum, request.gaps, request.dt)
    if step is None:
        return {"dt": None}, numbers
    is_days = step < 2e-5 and any(low < readings[0] < high for low, high in DAYS)
    if stated is None and (step >= 1.0 or is_days):  # a counter, or other units
        dt = request.dt or columns.dt
        if dt is None:
            why = f", as days do from {readings[0]:.10g} on" if is_days else ", too long for seconds"
            said = f"the clock of {file} (column {timer}) has a step of {step:.3g}{why}"
            raise ValueError(f"`clock_units` must be given, {said}. {SECONDS}, or `dt`.")
        scale, quantum, step = dt / step * scale, quantum * dt / step, dt
    if columns.dt is not None and not np.isclose(columns.dt, step, rtol=1e-3, atol=0.0):
        said = f"it states a step of {columns.dt:g} s and its clock {step:g} s"
        raise ValueError(f"{file} contradicts itself, {said}. Pass `clock_units`, or clock=False and `dt`.")
    return {"dt": step, "start": columns.origin + float(scale * readings[0]), "quantum": quantum}, numbers
