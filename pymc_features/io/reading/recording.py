"""Recordings: the channels of a file as the file states them, and as the caller wants them.

Every reader makes a `Recording`; which of its channels, in which units and on which clock is decided here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pymc_features._checks import SAMPLING_INTERVAL, listed, shown
from pymc_features._checks.messages import warn_caller
from pymc_features.io.reading.clock import Clock, check_increasing, even_clock
from pymc_features.io.reading.labels import MEASURED, role_of
from pymc_features.io.reading.lines import decoded
from pymc_features.io.reading.units import plural, resolve_dt, resolve_units, sensitivity_of

OPENING = 16_384  # bytes
TINY, ALONE = 1e-60, 1e3  # over the largest value, and the largest over the second: none is measured so
FEWEST = 10  # values among which one can be told


class Request(NamedTuple):
    """What the caller says about every file; None leaves it to the file."""

    columns: list | None = None
    units: str | float | None = None
    dt: float | None = None
    clock: str | int | bool | None = None  # False: no clock
    clock_units: float | None = None  # [s] per count
    skip: int = 0
    wrapped: bool | None = None  # whether one series runs along the lines of a text file
    gaps: bool = False  # whether samples may be missing: NaN, empty cells, rows that a clock passes over
    quantity: str = "acceleration"
    sensitivity: str | float | None = None


@dataclass(frozen=True)
class Opening:
    """The first bytes of a file, by which its format is recognised."""

    suffix: str  # of its name, in lower case
    head: bytes  # at most `OPENING` of them

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


class Channel(NamedTuple):
    """One channel of a recording, as its file states it; None where the file is silent."""

    name: str  # direction or number of the channel, label of the column
    values: np.ndarray  # (time,), in `unit`
    unit: str | None = None  # as the file says it, "g" for example
    dt: float | None = None  # sampling interval [s]
    times: np.ndarray | None = None  # (time,) [s], where they are uneven; `dt` is None then
    start: float | None = None  # time of the first sample [s], on a clock that files of this format share
    quantum: float = 0.0  # resolution of the times [s]
    label: str = ""  # what it is called besides: the header with its unit, the variable that it is a row of
    hidden: bool = False  # whether it is no measurement unless it is asked for: a clock, numbers of samples
    problem: str = ""  # why its values cannot be taken, if it is asked for


class Recording(NamedTuple):
    """What a file holds."""

    file: str  # what messages call it
    channels: Sequence[Channel]
    name: str | None = None  # by the file: event or station
    question: str = ""  # what is to be asked unless the caller names the channels
    skipped: bool = False  # whether the first samples are left out already, before the clock was looked at


@dataclass(frozen=True)
class Format:
    """A kind of files: what it is called, how it is recognised, what it states, how it is read."""

    name: str  # in messages and in the table of formats
    recognises: Callable[[Opening], bool]
    files: str  # usual endings of file names, for the table of formats
    states: str  # what its files say themselves, for the table of formats
    read: Callable[[Path, Request], Recording]  # its errors have the name of the file

    def recording(self, path: Path, request: Request) -> Recording:
        """The channels of a file; no file leaves the library with another error than ours."""
        try:
            found = self.read(path, request)
        except (ArithmeticError, LookupError, MemoryError, TypeError, UnicodeError) as error:
            raise ValueError(
                f"{path.name} must be a whole {self.name} file, it cannot be read ({error}). "
                "Fetch the file again."
            ) from error
        if not found.channels:
            raise ValueError(f"{path.name} ({self.name}) must hold an acceleration, none was found.")
        return found


def chosen(recording: Recording, columns: list | None, argument: str = "columns") -> list[Channel]:
    """The channels that the caller names by index or name, or all that are measurements."""
    channels = recording.channels
    if recording.question and not (columns and all(isinstance(column, str) for column in columns)):
        raise ValueError(recording.question)
    if columns is None:
        found = [channel for channel in channels if not channel.hidden]
    else:
        found = [channel for column in columns for channel in _find(recording, column, argument)]
    if not found:
        raise ValueError(
            f"`{argument}` must name a channel of {recording.file} ({named(channels)}), none is a "
            "measurement by its label. Pass the index (from 0) or the name of one."
        )
    return found


def named(channels: Sequence[Channel]) -> str:
    """Channels as a message lists them."""
    return listed([f"{c.name} [{c.unit}]" if c.unit else c.name for c in channels])


def _find(recording: Recording, column, argument: str) -> list[Channel]:
    """A channel by its index, or by its name or label; all rows of a variable by its name."""
    channels = recording.channels
    if isinstance(column, str):
        exact = [c for c in channels if column.strip() in (c.name, c.label)]
        wanted = column.strip().lower()
        matches = exact or [c for c in channels if wanted in (c.name.lower(), c.label.lower())]
        rows = len({channel.label for channel in matches}) == 1 and matches[0].label != matches[0].name
        if rows:  # of a variable, without its clock
            matches = [channel for channel in matches if not channel.hidden] or matches
    else:
        matches, rows = list(channels[column : column + 1]) if column >= 0 else [], False
    if not matches or (len(matches) > 1 and not rows):
        raise ValueError(
            f"`{argument}` must be one of the channels of {recording.file} ({named(channels)}), got "
            f"{shown(column)}. Pass the index (from 0) or the name of one."
        )
    return matches


def in_si(channel: Channel, request: Request, recording: Recording) -> tuple[np.ndarray, Clock]:
    """History (time,) of a channel in SI units at an even step, and its clock."""
    if channel.problem:
        raise ValueError(channel.problem)
    file, skip = recording.file, 0 if recording.skipped else request.skip
    role = role_of(channel.name)
    if channel.unit is None and role in MEASURED and role != request.quantity and request.sensitivity is None:
        raise ValueError(
            f"{file} must hold {plural(request.quantity)}, the label {channel.name!r} says {role}. "
            "Pass the columns that are, or rename it."
        )
    dt = resolve_dt(request.dt, _stated_step(channel, request, file), file)
    quantity = request.quantity if request.sensitivity is None else "voltage"
    factor = resolve_units(request.units, channel.unit, file, quantity)
    if request.sensitivity is not None:
        factor /= sensitivity_of(request.sensitivity, request.quantity)
    values = channel.values if channel.times is None else _interpolated(channel, dt, file)
    values = values[skip:]
    missing = np.flatnonzero(np.isnan(values))
    if missing.size and not request.gaps:
        raise ValueError(
            f"{file}, {channel.name}: no samples may be missing, {missing.size} are, the first after "
            f"{dt * missing[0]:.6g} s. Cut the file to one side, or use `read_channels_with_gaps`."
        )
    if values.size < 2 or np.isinf(values).any():
        raise ValueError(f"{file}, {channel.name}: at least 2 finite samples must be there, got others.")
    _warn_of_exponents(values, file, channel.name)
    start = None if channel.start is None or request.clock is False else channel.start + skip * dt
    return factor * values, Clock(file, values.size, dt, start, channel.quantum)


def _warn_of_exponents(values: np.ndarray, file: str, name: str) -> None:
    """A number among others of quite another size has a digit too many or too few in its exponent."""
    sizes = np.abs(values)
    sizes = sizes[sizes > 0.0]
    if sizes.size < FEWEST:
        return
    place = np.argmax(sizes)
    second = max(sizes[:place].max(initial=0.0), sizes[place + 1 :].max(initial=0.0))
    for odd, other in ((sizes[place], second), (sizes.min(), sizes[place])):
        if odd > ALONE * other or odd < TINY * other:
            warn_caller(
                f"{file}, {name}: a value of {odd:.4g} is of another size than others, up to {other:.4g}. Is "
                "its exponent spoilt?"
            )


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
    check_increasing(times, where)
    try:
        return {"dt": even_clock(times, where, quantum)[0]}
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
        warn_caller(
            f"{file} ({channel.name}): at dt={dt:g} s the peak of its uneven values falls from {before:.4g} "
            f"to {after:.4g} {channel.unit}. Pass a smaller `dt`."
        )
    return values
