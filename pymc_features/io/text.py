"""Text and CSV files: columns of numbers below an optional header."""

import operator
import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from pymc_features.io.lines import not_a_number, read_lines, to_number
from pymc_features.io.units import known_factor, resolve_dt, resolve_units, time_step, warn_user
from pymc_features.records import Record

_SEPARATORS = (r"\t", ";", ",", r"\s+")
_COMMENTS = ("#", "%", "//")
_BRACKET = re.compile(r"[\[(]\s*([^\])]*?)\s*[\])]")
_TIME_SCALES = {"ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6}


@dataclass(frozen=True)
class _Table:
    file: str
    header: list[str]  # lines above the numbers, comment signs removed
    labels: list[list[str]]  # those header lines that split into one label per column
    values: np.ndarray  # (row, column)
    lines: list[int]  # line number of every row
    quantum: float  # resolution of the printed first column

    def where(self, row: int) -> str:
        return f"{self.file}, line {self.lines[row]}"

    def label(self, index: int) -> list[str]:
        return [labels[index] for labels in self.labels]


def read_text(path: Path, *, units=None, dt=None, column=None) -> Record:
    """Read one acceleration series from columns of numbers; see `read_record`."""
    table = _parse(path)
    index = _pick(table, column)
    step = _step(table, index, dt, column)
    factor = resolve_units(units, _stated_unit(table, index), table.file)
    return Record(factor * table.values[:, index], step, name=path.stem)


def _split(line: str, separator: str) -> list[str]:
    cells = [cell.strip().strip('"') for cell in re.split(separator, line.strip())]
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def _separator(line: str) -> str | None:
    """The separator that turns a line into numbers, None if none does."""
    for separator in _SEPARATORS:
        if all(to_number(cell) is not None for cell in _split(line, separator)):
            return separator
    return None


def _parse(path: Path) -> _Table:
    file = path.name
    lines = [(n, line.strip()) for n, line in enumerate(read_lines(path), 1) if line.strip()]
    if not lines:
        raise ValueError(f"{file} must hold at least 2 samples, it is empty.")
    header, bare = [], []
    for start in range(len(lines)):
        number, line = lines[start]
        if line.startswith(_COMMENTS):
            header.append(line.lstrip("#%/ \t"))
        elif (separator := _separator(line)) is not None:
            break
        else:
            header.append(line)
            bare.append((number, line))
    else:
        raise ValueError(
            f"{file} must hold rows of numbers, none was found in its {len(lines)} lines. "
            "Use a decimal point, and a comma, semicolon, tab or blank between columns."
        )
    n_columns = len(_split(lines[start][1], separator))
    for number, line in bare:  # a spoilt first row must not pass for a header
        cells = _split(line, separator)
        if len(cells) == n_columns > 1 and to_number(cells[0]) is not None:
            bad = next(cell for cell in cells if to_number(cell) is None)
            raise not_a_number(f"{file}, line {number}", bad)
    body = [(n, line) for n, line in lines[start:] if not line.startswith(_COMMENTS)]
    cells = [_row(file, n, line, separator, n_columns) for n, line in body]
    values = np.array([[to_number(cell) for cell in row] for row in cells])
    if values.shape[0] < 2:
        raise ValueError(f"{file} must hold at least 2 samples, got {values.shape[0]}.")
    return _Table(
        file,
        header,
        [labels for line in header if (labels := _labels(line, n_columns))],
        values,
        [n for n, _ in body],
        _quantum([row[0] for row in cells], np.abs(values[:, 0]).max()),
    )


def _row(file: str, number: int, line: str, separator: str, n_columns: int) -> list[str]:
    cells = _split(line, separator)
    where = f"{file}, line {number}"
    for cell in cells:
        value = to_number(cell)
        if value is None or not np.isfinite(value):
            raise not_a_number(where, cell)
    if len(cells) != n_columns:
        raise ValueError(
            f"{where}: rows must have {n_columns} values like the first, got {len(cells)}. "
            "Complete or cut the row."
        )
    return cells


def _labels(line: str, n_columns: int) -> list[str] | None:
    """One label per column, blanks allowed before a bracket: "time [s] acc [g]"."""
    ways = [_split(line, separator) for separator in _SEPARATORS]
    ways.append(re.findall(r"[^\s\[(]+\s*[\[(][^\])]*[\])]|\S+", line))
    return next((labels for labels in ways if len(labels) == n_columns), None)


def _quantum(tokens: list[str], largest: float) -> float:
    """Resolution of printed numbers, from their decimals and their significant digits."""
    parts = [Decimal(token.replace("d", "e").replace("D", "e")).as_tuple() for token in tokens]
    decimals = 10.0 ** min(part.exponent for part in parts)
    if largest == 0.0:
        return decimals
    digits = max(len(part.digits) for part in parts)
    return max(decimals, 10.0 ** (np.floor(np.log10(largest)) - digits + 1))


def _pick(table: _Table, column) -> int:
    """Index of the acceleration column."""
    n_columns = table.values.shape[1]
    names = ", ".join(table.labels[-1]) if table.labels else f"0 to {n_columns - 1}"
    if column is None:
        if n_columns > 2:
            raise ValueError(
                f"`column` must be given, {table.file} has {n_columns} columns: {names}. "
                "Pass the index (from 0) or the header name of the acceleration."
            )
        return n_columns - 1
    if isinstance(column, str):
        matches = {
            index
            for index in range(n_columns)
            for label in table.label(index)
            if column.strip() in (label, _BRACKET.sub("", label).strip())
        }
    else:
        try:
            matches = {operator.index(column)} & set(range(n_columns))
        except TypeError:
            raise TypeError(f"`column` must be an index or a name, got {column!r}.") from None
    if len(matches) != 1:
        raise ValueError(
            f"`column` must be one of the columns of {table.file} ({names}), got {column!r}. "
            "Pass the index (from 0) or the header name of the acceleration."
        )
    return matches.pop()


def _step(table: _Table, index: int, dt: float | None, column) -> float:
    """Sampling interval [s] from the first column, unless that is the acceleration, or `dt`."""
    stated = None
    if index > 0:
        unit = next((m[1] for t in table.label(0) if (m := _BRACKET.search(t))), "s")
        scale = _TIME_SCALES.get(unit.lower(), 1.0)
        times = scale * table.values[:, 0]
        try:
            stated = time_step(times, table.where, scale * table.quantum)
        except ValueError as error:
            if column is None or (np.diff(times) > 0.0).all():  # it is meant as time
                if dt is None:
                    raise
                warn_user(f"{error} The argument dt={dt:g} s is used.")
    if stated is not None and stated >= 1.0 and dt is not None:
        stated = None  # a counter, or milliseconds, does not contradict `dt`
    return resolve_dt(dt, stated, table.file)


def _stated_unit(table: _Table, index: int) -> str | None:
    """Acceleration unit in brackets above the column, or anywhere in an unlabelled header."""
    texts = table.label(index) if table.labels else table.header
    units = [unit for text in texts for unit in _BRACKET.findall(text)]
    return next((unit for unit in units if known_factor(unit) is not None), None)
