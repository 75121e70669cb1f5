"""PEER AT2 files.

A few header lines say what the values are, how many (NPTS) and how far apart (DT); the values
follow, several to a line, in reading order. The spelling of headers has varied over the decades.
"""

import re
from array import array
from pathlib import Path

import numpy as np

from pymc_features.io.lines import Lines, not_a_number, to_number
from pymc_features.io.recording import Channel, Format, Opening, recorded
from pymc_features.io.units import known_factor

NAME = "PEER AT2"
MOST_HEADER_LINES = 200

# of lines with single blanks; all repetitions are bounded, so that the time is proportional to the text
_NUMBER = r"[-+]?(?:\d{1,20}(?:\.\d{0,20})?|\.\d{1,20})(?:[eEdD][-+]?\d{1,3})?"
_NPTS = re.compile(r"\bNPTS\s?[=:]\s?(\d{1,12})(?!\d)", re.IGNORECASE | re.ASCII)
_DT = re.compile(rf"\bDT\s?[=:]\s?({_NUMBER})", re.IGNORECASE | re.ASCII)
_NPTS_DT = re.compile(
    rf"(?<!\d)(\d{{1,12}})\s?,?\s({_NUMBER})\s?,?\s?NPTS\s?,?\s?DT", re.IGNORECASE | re.ASCII
)
_UNITS = re.compile(r"\bunits\s?(?:\b(?:of|are|is|in)\b|[=:(])\s?\(?\s?([a-z/0-9^*²]{1,40})", re.IGNORECASE)
_ACCELERATION_IN = re.compile(r"acceleration[a-z ]{0,60}\bin\s?\(?\s?([a-z/0-9^*]{1,40})", re.IGNORECASE)
_DATE = re.compile(r"\b\d{1,2}/\d{1,2}/\d{2,4}\b", re.ASCII)
_GLUED = re.compile(r"(?<=[\d.])([-+])", re.ASCII)


def recognises(opening: Opening) -> bool:
    """By the suffix, or by a line with both NPTS and DT."""
    lines = (line.upper() for line in opening.lines[:20])
    return opening.suffix == ".at2" or any("NPTS" in line and "DT" in line for line in lines)


def read(path: Path) -> tuple[list[Channel], str | None]:
    """The single series of a file, and its event."""
    lines = Lines(path, NAME)
    start, header = _first_value_line(lines)
    text = "\n".join(header)
    n_values, step = _count_and_step(text)
    values = _values(lines, start)
    if n_values is not None and len(values) != n_values:
        raise ValueError(
            f"{lines.title} must hold the NPTS = {n_values} values its header announces, got "
            f"{len(values)}. Fetch the file again or correct the header."
        )
    return [Channel(path.stem, values, _stated_unit(text), step)], _event(header)


def _tokens(line: str) -> list[str]:
    """Values of a line; Fortran glues a value to the one before it when both fill their fields."""
    return _GLUED.sub(r" \1", line.replace(",", " ")).split()


def _first_value_line(lines: Lines) -> tuple[int, list[str]]:
    """Number of the first line of numbers alone, below the NPTS line if there is one; the lines above it."""
    npts = next((number for number, line in lines if "NPTS" in line.upper()), 0)
    header = []
    for number, line in lines:
        tokens = _tokens(line)
        if number > npts and tokens and all(to_number(token) is not None for token in tokens):
            return number, header
        if number <= npts or len(header) < MOST_HEADER_LINES:
            header = [*header[-MOST_HEADER_LINES:], " ".join(line.split())]
    raise ValueError(f"{lines.title} must hold values below its header, none was found. Is it an AT2 file?")


def _count_and_step(header: str) -> tuple[int | None, float | None]:
    """NPTS and DT [s] of the header, None for what it does not state."""
    if both := _NPTS_DT.search(header):
        n_values, step = both.groups()
    else:
        n_values, step = (m and m[1] for m in (_NPTS.search(header), _DT.search(header)))
    step = to_number(step) if step else None
    return int(n_values) if n_values else None, step or None  # DT = 0 states nothing


def _values(lines: Lines, start: int) -> np.ndarray:
    """All values down to the end or to a line of stars, "*** End Data ***"."""
    values = array("d")
    for number, line in lines:
        if number < start:
            continue
        if line.startswith("***"):
            break
        for token in _tokens(line):
            value = to_number(token)
            if value is None or not np.isfinite(value):
                raise not_a_number(f"{lines.title}, line {number}", token)
            values.append(value)
    return np.array(values)


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


AT2 = Format(NAME, recognises, ".AT2", "step, number of values, units, event", recorded(read))
