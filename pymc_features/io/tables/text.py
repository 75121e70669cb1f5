"""Text and CSV files: columns of numbers below an optional header."""

from pathlib import Path

import numpy as np

from pymc_features.io.reading.clock import Request
from pymc_features.io.reading.units import resolve_dt, resolve_units, time_step, warn_user
from pymc_features.io.tables.table import Table, check_not_wrapped, parse_table
from pymc_features.io.tables.text_channels import clock_scale, refuse_no_history
from pymc_features.records import Record


def read_text(path: Path, request: Request) -> Record:
    """Read one acceleration series from columns of numbers; see `read_record`."""
    column = None if request.columns is None else request.columns[0]
    table = parse_table(path, wrapped=request.wrapped)
    clock = bool((np.diff(table.values[:, 0]) > 0.0).all())
    check_not_wrapped(table, request.wrapped, clock, isinstance(column, str))
    index = _pick(table, column)
    step = _step(table, index, request.dt, column)
    factor = resolve_units(request.units, table.stated_unit(index), table.file)
    return Record(factor * table.values[:, index], step, name=path.stem)


def _pick(table: Table, column) -> int:
    """Index of the acceleration column."""
    n_columns = table.values.shape[1]
    if column is None:
        if n_columns > 2:
            raise ValueError(
                f"`column` must be given, {table.file} has {n_columns} columns: {table.names()}. "
                "Pass the index (from 0) or the header name of the acceleration."
            )
        return n_columns - 1
    return table.find(column, "column", "acceleration")


def _step(table: Table, index: int, dt: float | None, column) -> float:
    """Sampling interval [s] from time stamps or the first column, unless it is the acceleration, or `dt`."""
    stated, timer = None, table.stamp or 0
    if index != timer:
        refuse_no_history(table)
        times = table.values[:, timer]
        forward = bool((np.diff(times) > 0.0).all())
        scale = (clock_scale(table, timer) if forward or table.role(timer) == "time" else None) or 1.0
        times = scale * times
        try:
            stated = time_step(times, table.where, scale * table.quantum(timer))
        except ValueError as error:
            if column is None or forward:  # it is meant as time
                if dt is None:
                    raise
                warn_user(f"{error} The argument dt={dt:g} s is used.")
    if stated is not None and stated >= 1.0 and dt is not None:
        stated = None  # a counter, or milliseconds, does not contradict `dt`
    return resolve_dt(dt, stated, table.file)
