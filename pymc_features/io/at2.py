"""PEER AT2 files.

A few header lines say what the values are, how many (NPTS) and how far apart (DT); the values
follow, several to a line, in reading order. The spelling of headers has varied over the decades.
"""

import re
from pathlib import Path

import numpy as np

from pymc_features.io.lines import FLOAT, not_a_number, read_lines, to_number
from pymc_features.io.units import known_factor, resolve_dt, resolve_units
from pymc_features.records import Record

_NPTS = re.compile(r"\bNPTS\s*[=:]\s*(\d+)", re.IGNORECASE)
_DT = re.compile(rf"\bDT\s*[=:]\s*({FLOAT})", re.IGNORECASE)
_NPTS_DT = re.compile(rf"(\d+)\s*,?\s+({FLOAT})\s*,?\s*NPTS\s*,?\s*DT", re.IGNORECASE)
_UNITS = re.compile(r"\bunits\s*(?:\b(?:of|are|is|in)\b|[=:(])\s*\(?\s*([a-z/0-9^*²]+)", re.IGNORECASE)
_ACCELERATION_IN = re.compile(r"acceleration[a-z ]*\bin\s*\(?\s*([a-z/0-9^*]+)", re.IGNORECASE)
_DATE = re.compile(r"\b\d{1,2}/\d{1,2}/\d{2,4}\b")


def read_at2(path: Path, *, units=None, dt=None, column=None) -> Record:
    """Read the single series of a PEER AT2 file; see `read_record`."""
    if column is not None:
        raise ValueError(
            f"`column` must be None for an AT2 file, got {column!r}. {path.name} holds one series."
        )
    lines = read_lines(path)
    start = _first_value_line(lines, path.name)
    header = [" ".join(line.split()) for line in lines[:start]]
    n_values, step = _count_and_step("\n".join(header))
    values = _values(lines, start, path.name)
    if n_values is not None and len(values) != n_values:
        raise ValueError(
            f"{path.name} must hold the NPTS = {n_values} values its header announces, got "
            f"{len(values)}. Fetch the file again or correct the header."
        )
    step = resolve_dt(dt, step, path.name)
    factor = resolve_units(units, _stated_unit("\n".join(header)), path.name)
    return Record(factor * np.array(values), step, name=_event(header) or path.stem)


def _tokens(line: str) -> list[str]:
    """Values of a line; Fortran glues a value to the one before it when both fill their fields."""
    return re.sub(r"(?<=[\d.])([-+])", r" \1", line.replace(",", " ")).split()


def _first_value_line(lines: list[str], file: str) -> int:
    """Index of the first line of numbers alone, below the NPTS line if there is one."""
    npts = next((i for i, line in enumerate(lines) if "NPTS" in line.upper()), -1)
    for i, line in enumerate(lines[npts + 1 :], npts + 1):
        tokens = _tokens(line)
        if tokens and all(to_number(token) is not None for token in tokens):
            return i
    raise ValueError(f"{file} must hold values below its header, none was found. Is it an AT2 file?")


def _count_and_step(header: str) -> tuple[int | None, float | None]:
    """NPTS and DT [s] of the header, None for what it does not state."""
    if both := _NPTS_DT.search(header):
        n_values, step = both.groups()
    else:
        n_values, step = (m and m[1] for m in (_NPTS.search(header), _DT.search(header)))
    step = to_number(step) if step else None
    return int(n_values) if n_values else None, step or None  # DT = 0 states nothing


def _values(lines: list[str], start: int, file: str) -> list[float]:
    """All values down to the end or to a line of stars, "*** End Data ***"."""
    values = []
    for number, line in enumerate(lines[start:], start + 1):
        if line.lstrip().startswith("***"):
            break
        for token in _tokens(line):
            value = to_number(token)
            if value is None or not np.isfinite(value):
                raise not_a_number(f"{file}, line {number}", token)
            values.append(value)
    return values


def _stated_unit(header: str) -> str | None:
    """ "G" from "IN UNITS OF G", "The units are (g)", "Acceleration in g"; None if silent."""
    if match := _UNITS.search(header):
        return match[1]
    match = _ACCELERATION_IN.search(header)
    return match[1] if match and known_factor(match[1]) is not None else None


def _event(header: list[str]) -> str | None:
    """The header line with a date, if it is the only one."""
    dated = [line for line in header if _DATE.search(line)]
    return dated[0] if len(dated) == 1 else None
