"""Measured files and their clocks: steps, gaps, and the window that several clocks have in common."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pymc_features._checks import is_number, listed, shown, single, to_float
from pymc_features.io.reading.labels import unit_of
from pymc_features.io.reading.units import time_step
from pymc_features.signals.channels import warn_channel

_SIMULTANEOUS = 0.05  # of a sample; what clocks may differ by without a word
_DRIFT = 0.5  # of a sample, from the first to the last sample in common


@dataclass(frozen=True)
class Clock:
    """When the samples of one file were taken."""

    file: str
    n_times: int
    dt: float  # [s]
    start: float | None = None  # reading at the first sample [s], None if the file has no clock
    quantum: float = 0.0  # resolution of the readings [s]

    @property
    def stop(self) -> float:
        """Reading at the last sample [s]."""
        return self.start + (self.n_times - 1) * self.dt


@dataclass(frozen=True)
class Window:
    """Samples that several clocks have in common."""

    dt: float  # [s]
    start: float  # reading of the clocks at the first common sample [s], 0 without clocks
    n_times: int
    first: tuple[int, ...]  # first common sample of every file


@dataclass(frozen=True)
class MeasuredFile:
    """Channels of one file, all sampled at the same times."""

    names: list[str]
    values: np.ndarray  # (channel, time) [m/s^2], NaN where there are gaps
    clock: Clock


@dataclass(frozen=True)
class Request:
    """What the caller says about every file; None leaves it to the file."""

    columns: list | None = None
    units: str | float | None = None
    dt: float | None = None
    clock: str | int | bool | None = None  # False: no clock
    clock_units: float | None = None  # [s] per count
    skip: int = 0
    wrapped: bool | None = None  # whether one series runs along the lines of a text file
    gaps: bool = False  # whether samples may be missing: NaN, empty cells, rows that a clock passes over


def clock_seconds(units) -> float:
    """Seconds per unit of a clock: "s", "ms", "us", "ns", "min", "h" or a positive number."""
    if isinstance(units, str) and (known := unit_of(units)) is not None and known.quantity == "time":
        return known.factor
    if is_number(single(units)) and 0.0 < to_float(single(units)) < np.inf:
        return to_float(single(units))
    raise ValueError(
        '`clock_units` must be "s", "ms", "us", "ns", "min", "h" or a positive number of seconds, got '
        f"{shown(units)}."
    )


def even_clock(times: np.ndarray, where: Callable[[int], str], quantum: float, gaps: bool):
    """Sampling interval [s] of a clock (time,), and the number of each of its samples, from 0 (time,).

    Parameters
    ----------
    times : ndarray (time,)
        Readings [s].
    where : callable
        How a message calls the place of a row.
    quantum : float
        Resolution of the readings [s].
    gaps : bool
        Whether samples may be missing; then half of them, at most.

    Raises
    ------
    ValueError
        If samples are missing, repeated or uneven; the message names the first place.
    """
    steps = np.diff(times)
    if not (steps > 0.0).all():
        row = int(np.argmax(steps <= 0.0)) + 1
        raise ValueError(
            f"{where(row)}: the clock must run forward, it goes from {times[row - 1]:.10g} s to "
            f"{times[row]:.10g} s. Cut the file there, or pass `clock`, the column with the times."
        )
    usual = float(steps[steps < 1.5 * np.median(steps)].mean())  # of printed times no step is exact
    missing = np.rint(steps / usual)
    off, slack = np.abs(steps - missing * usual), 0.1 * usual + 2.0 * quantum
    whole = (off <= 0.1 * usual).all() or (slack < 0.4 * usual and (off <= slack * missing).all())
    numbers = np.arange(times.size)
    if (missing > 1.0).any() and whole:
        row = int(np.argmax(missing > 1.0)) + 1
        if gaps and missing.sum() < 2.0 * times.size:
            numbers = np.append(0, np.cumsum(missing.astype(np.int64)))
            return time_step(times, where, quantum, numbers), numbers
        raise ValueError(
            f"{where(row)}: no samples may be missing, {int((missing - 1.0).sum())} are, in "
            f"{int((missing > 1.0).sum())} gap(s), the first from {times[row - 1]:.10g} s to "
            f"{times[row]:.10g} s at a step of {usual:.4g} s. Cut the file to one side, or fill the gap."
        )
    return time_step(times, where, quantum), numbers


def at_samples(values: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Values (channel, row) at the numbers of their samples (row,), NaN where there is none."""
    if values.shape[1] == numbers[-1] + 1:
        return values
    whole = np.full((values.shape[0], numbers[-1] + 1), np.nan)
    whole[:, numbers] = values
    return whole


def common_window(clocks: list[Clock]) -> Window:
    """The samples that all clocks have, aligned to whole samples.

    Raises
    ------
    ValueError
        If the clocks have different steps or no time in common, or some files have none.

    Warns
    -----
    ChannelWarning
        If clocks are not simultaneous to a twentieth of a sample, or more than half of a file is cut off.
    """
    first = clocks[0]
    for clock in clocks[1:]:
        n = min(first.n_times, clock.n_times)
        if abs(clock.dt - first.dt) * (n - 1) > _DRIFT * first.dt:
            raise ValueError(
                f"Sensors must have a common clock, the step is {first.dt:.10g} s in {first.file} and "
                f"{clock.dt:.10g} s in {clock.file}. Resample one of them first."
            )
    if any(clock.start is None for clock in clocks):
        return _without_clocks(clocks)
    dt = float(f"{np.mean([clock.dt for clock in clocks]):.10g}")
    latest = max(clock.start for clock in clocks)
    steps = int(np.rint((latest - first.start) / dt))  # of the first clock, to which the others are aligned
    starts = np.array([clock.start for clock in clocks])
    skipped = np.rint((first.start + steps * dt - starts) / dt).astype(int)
    start = first.start + steps * dt
    n_times = min(clock.n_times - k for clock, k in zip(clocks, skipped, strict=True))
    if n_times < 2:
        ranges = listed([f"{clock.file} {clock.start:.6g} s to {clock.stop:.6g} s" for clock in clocks])
        raise ValueError(
            f"Sensors must have a common clock, these have no time in common: {ranges}. Pass clock=False "
            "and `dt` if the files start together, or one event only."
        )
    for clock, late in zip(clocks, starts + skipped * dt - start, strict=True):
        if abs(late) > _SIMULTANEOUS * dt + 2.0 * clock.quantum:
            warn_channel(
                f"{clock.file}: its samples come {1e3 * abs(late):.3g} ms ({abs(late) / dt:.2g} samples) "
                f"{'after' if late > 0.0 else 'before'} those of {first.file} by the clocks; they are taken "
                "as simultaneous. Resample it first if that matters."
            )
        if n_times < 0.5 * clock.n_times:
            warn_channel(
                f"{clock.file}: only {n_times} of its {clock.n_times} samples are in the window that all "
                "sensors have in common. Check for a file that starts late or ends early."
            )
    return Window(dt, start, n_times, tuple(int(k) for k in skipped))


def _without_clocks(clocks: list[Clock]) -> Window:
    bare = [clock for clock in clocks if clock.start is None]
    if len(bare) < len(clocks):
        raise ValueError(
            f"Sensors must have a common clock, {bare[0].file} has none and others do. Pass `clock`, the "
            "column with the times, or clock=False and `dt` if all files start together."
        )
    lengths = [clock.n_times for clock in clocks]
    if len(set(lengths)) > 1:
        sizes = listed([f"{clock.file} {clock.n_times}" for clock in clocks])
        raise ValueError(
            f"Sensors without clocks must have the same number of samples, got {sizes}. Cut them to the "
            "same window first."
        )
    return Window(clocks[0].dt, 0.0, lengths[0], (0,) * len(clocks))
