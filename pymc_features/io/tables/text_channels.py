"""Channels of text and CSV files: the exports of loggers and of tables."""

from pathlib import Path

import numpy as np

from pymc_features.io.reading.clock import (
    Clock,
    MeasuredFile,
    Request,
    at_samples,
    even_clock,
)
from pymc_features.io.reading.labels import NO_HISTORY
from pymc_features.io.reading.units import resolve_dt, resolve_units
from pymc_features.io.tables.table import Table, check_not_wrapped, parse_table

#: Seconds per count of the microsecond counter in exports of Movella (Xsens) DOT sensors, by its label.
COUNTERS = {"sampletimefine": 1e-6}


def read_text_channels(path: Path, request: Request) -> MeasuredFile:
    """Read columns of a text file and its clock; see `read_channels`."""
    table = parse_table(path, request.skip, request.wrapped, request.gaps)
    timer = _clock_column(table, request.clock)
    named = request.columns is not None and all(isinstance(column, str) for column in request.columns)
    check_not_wrapped(table, request.wrapped, timer is not None, named)
    if request.columns is None:
        others = [index for index in range(table.values.shape[1]) if index != timer]
        picked = [i for i in others if table.role(i) != "number" or table.stated_unit(i) is not None]
    else:
        picked = [table.find(column, "columns", "acceleration") for column in request.columns]
    if not picked or timer in picked:
        raise ValueError(
            f"`columns` must name accelerations in {table.file}, beside its clock (column {timer}), which is "
            f"one of or all that is picked among {table.names()}. Pass others, or `clock`."
        )
    factors = [resolve_units(request.units, table.stated_unit(index), table.file) for index in picked]
    values = np.array(factors)[:, None] * table.values[:, picked].T
    names = [table.name(index) or f"column {index}" for index in picked]
    clock, numbers = _clock(table, timer, request)
    return MeasuredFile(names, at_samples(values, numbers), clock)


def _clock_column(table: Table, clock) -> int | None:
    """Index of the column with the times: as asked, by its label, or a first column that runs forward."""
    if clock is False:
        return None
    if clock is not None:
        return table.find(clock, "clock", "times")
    n_columns = table.values.shape[1]
    if table.stamp is not None:
        return table.stamp
    refuse_no_history(table)
    if labelled := [i for i in range(n_columns) if table.role(i) == "time"]:
        return labelled[0]
    is_other = table.unit_of(0, "time") is None and (table.role(0) or "number") != "number"
    forward = n_columns > 1 and not is_other and (np.diff(table.values[:, 0]) > 0.0).mean() > 0.9
    return 0 if forward else None


def refuse_no_history(table: Table) -> None:
    """Refuse a table over something else than time."""
    for index in range(table.values.shape[1]):
        role = table.role(index)
        if role in NO_HISTORY and (index == 0 or role == "spectral"):
            raise ValueError(
                f"{table.file} must be a history over time, got a column {table.label(index)[-1]!r}. If it "
                "is one, pass clock=False with `dt` and `columns`, or `clock`, the column with the times."
            )


def clock_scale(table: Table, timer: int) -> float | None:
    """Seconds per unit of a clock by its label; None where that does not say it.

    Raises
    ------
    ValueError
        If its label has a unit that is not understood.
    """
    if timer == table.stamp:
        return 1.0
    if (stated := table.unit_of(timer, "time")) is not None:
        return stated
    if table.brackets(timer):
        raise ValueError(
            f"`clock_units` must be given, {table.file} states {table.brackets(timer)[-1]!r} of its clock, "
            'which is no known unit of time. Pass "s", "ms", "us" or the seconds per count.'
        )
    return COUNTERS.get((table.name(timer) or "").lower())


def _clock(table: Table, timer: int | None, request: Request) -> tuple[Clock, np.ndarray]:
    """The clock, and the numbers of the samples (row,)."""
    n_times = table.values.shape[0]
    if timer is None:
        return Clock(table.file, n_times, resolve_dt(request.dt, None, table.file)), np.arange(n_times)
    without = np.flatnonzero(np.isnan(table.values[:, timer]))
    if without.size:
        raise ValueError(
            f"{table.where(int(without[0]))}: the clock must have a time in every row, got none. Cut the row."
        )
    stated = clock_scale(table, timer) if request.clock_units is None else request.clock_units
    scale, quantum = 1.0 if stated is None else stated, table.quantum(timer)
    times = scale * table.values[:, timer]
    step, numbers = even_clock(times, table.where, scale * quantum, request.gaps)
    if step >= 1.0 and stated is None:  # a counter, or other units
        if request.dt is None:
            raise ValueError(
                f"`clock_units` must be given, the clock of {table.file} (column {timer}) has a step of "
                f"{step:g}, "
                'too long for seconds. Pass "ms", "us" or the seconds per count.'
            )
        scale = request.dt / step
        times, step = scale * table.values[:, timer], request.dt
    dt = resolve_dt(request.dt, step, table.file)
    return Clock(table.file, int(numbers[-1]) + 1, dt, float(times[0]), scale * quantum), numbers
