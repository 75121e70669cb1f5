"""Tables with a column for each sensor, of text, MATLAB or pandas: which column is the clock."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pymc_features._checks import listed, shown
from pymc_features.io.reading.clock import at_samples, even_clock
from pymc_features.io.reading.labels import NO_HISTORY, Label
from pymc_features.io.reading.recording import Channel, Recording, Request

#: Seconds per count of the microsecond counter in exports of Movella (Xsens) DOT sensors, by its label.
COUNTERS = {"sampletimefine": 1e-6}


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
    _check_other_clocks(columns, timer, request)
    place, numbers = _clock(columns, timer, request)
    channels = []
    for index, label in enumerate(columns.labels):
        is_time = label.role == "time" and (label.known is None or label.known.quantity == "time")
        hidden = index == timer or is_time or (label.role == "number" and label.unit is None)
        problem = "" if index != timer else f"`columns` must name measurements, column {index} is the clock."
        values = at_samples(columns.values[:, index], numbers)
        name = label.name or f"column {index}"
        unit = label.unit or columns.units
        channels.append(
            Channel(name, values, unit, **place, label=label.text, hidden=hidden, problem=problem)
        )
    return Recording(columns.file, channels, question=question, skipped=True)


def _check_other_clocks(columns: Columns, timer: int | None, request: Request) -> None:
    """Refuse a table in which each channel has times of its own, unless the caller says which."""
    if timer is None or request.clock is not None:
        return
    scale = request.clock_units or clock_scale(columns, timer) or 1.0
    times = scale * columns.values[:, timer]
    for index, label in enumerate(columns.labels):
        unit = label.known
        if index == timer or label.role != "time" or unit is None or unit.quantity != "time":
            continue
        own = unit.factor * columns.values[:, index]
        if np.nanmax(np.abs(own - own[0] - times + times[0])) > 0.5 * np.nanmedian(np.diff(times)):
            raise ValueError(
                f"`clock` must be given, {columns.file} has {columns.labels[timer].text!r} and "
                f"{label.text!r}, which run apart. Read the channels of each clock by themselves, by `clock` "
                "and `columns`."
            )


def clock_column(columns: Columns, clock) -> int | None:
    """Index of the column with the times: as asked, by its label, or a first column that runs forward."""
    if clock is False:
        return None
    if clock is not None:
        texts = [label.text for label in columns.labels]
        asked = clock.strip() if isinstance(clock, str) else clock
        matches = {k for k, label in enumerate(columns.labels) if asked in (k, label.text, label.name)}
        if len(matches) != 1:
            known = listed(texts) if any(texts) else f"0 to {len(texts) - 1}"
            raise ValueError(
                f"`clock` must be one of the columns of {columns.file} ({known}), got {shown(clock)}. Pass "
                "the index (from 0) or the header name of the times."
            )
        return matches.pop()
    if columns.stamp is not None:
        return columns.stamp
    for index, label in enumerate(columns.labels):
        if label.role in NO_HISTORY and (index == 0 or label.role == "spectral"):
            raise ValueError(
                f"{columns.file} must be a history over time, got a column {label.text!r}. If it is one, "
                "pass clock=False with `dt` and `columns`, or `clock`, the column with the times."
            )
    if labelled := [index for index, label in enumerate(columns.labels) if label.role == "time"]:
        return labelled[0]
    first = columns.labels[0]
    is_time = first.known is not None and first.known.quantity == "time"
    open_ = is_time or not columns.own or first.role in (None, "number")
    forward = len(columns.labels) > 1 and open_ and (np.diff(columns.values[:, 0]) > 0.0).mean() > 0.9
    if forward and first.text and first.role is None and not is_time and columns.own:
        raise ValueError(
            f"`clock` must be given, {columns.file} does not say whether {first.text!r}, which runs forward, "
            "is the time. Call it time, or pass clock=False with `dt` and `columns`."
        )
    return 0 if forward else None


def clock_scale(columns: Columns, timer: int) -> float | None:
    """Seconds per unit of a clock by its label; None where that does not say it."""
    label = columns.labels[timer]
    if timer == columns.stamp:
        return 1.0
    if label.known is not None and label.known.quantity == "time":
        return label.known.factor
    if label.unit is not None:
        raise ValueError(
            f"`clock_units` must be given, {columns.file} states {label.unit!r} of its clock, "
            'which is no known unit of time. Pass "s", "ms", "us" or the seconds per count.'
        )
    return COUNTERS.get(label.name.lower())


def _clock(columns: Columns, timer: int | None, request: Request) -> tuple[dict, np.ndarray]:
    """Step, start and resolution of the clock, and the numbers of the samples (row,)."""
    numbers = np.arange(columns.values.shape[0])
    if timer is None:
        return {"dt": columns.dt}, numbers
    readings = columns.values[:, timer]
    without = np.flatnonzero(np.isnan(readings))
    if without.size:
        raise ValueError(
            f"{columns.where(int(without[0]), timer)}: the clock must have a time in every row, got none. "
            "Cut the row."
        )
    asked, unit = request.clock_units, columns.labels[timer].known
    if asked is not None and unit is not None and not np.isclose(unit.factor, asked, rtol=1e-6):
        raise ValueError(
            f"`clock_units` must be those of the file, {columns.file} states {columns.labels[timer].text!r}, "
            f"got {asked:g} s. Leave it out, or correct the file."
        )
    stated = clock_scale(columns, timer) if asked is None else asked
    scale = 1.0 if stated is None else stated
    quantum = scale * columns.resolution(timer)
    step, numbers = even_clock(
        scale * readings, lambda row: columns.where(row, timer), quantum, request.gaps, request.dt
    )
    if step is None:
        return {"dt": None}, numbers
    if step >= 1.0 and stated is None:  # a counter, or other units
        if request.dt is None:
            raise ValueError(
                f"`clock_units` must be given, the clock of {columns.file} (column {timer}) has a step of "
                f'{step:g}, too long for seconds. Pass "ms", "us" or the seconds per count, or `dt`.'
            )
        scale, quantum, step = request.dt / step * scale, quantum * request.dt / step, request.dt
    if columns.dt is not None and not np.isclose(columns.dt, step, rtol=1e-3, atol=0.0):
        raise ValueError(
            f"{columns.file} contradicts itself, it states a step of {columns.dt:g} s and its clock "
            f"{step:g} s. Pass `clock_units`, or clock=False and `dt`."
        )
    return {"dt": step, "start": columns.origin + float(scale * readings[0]), "quantum": quantum}, numbers
