"""Modes in a text table: a row for each mode, and columns with names above them.

    frequency [Hz],frequency_sd,damping,floor 1,floor 2,roof
    1.21,0.01,0.012,0.33,0.71,1.0
    3.47,0.02,0.010,0.88,0.41,-0.9

A column `mode` that names a mode in several rows makes them identifications of one. A table with a row for
each test has a column for each mode in place of `frequency`: f1 [Hz], f2 [Hz]; other columns are not read.

Columns that are no quantity are channels, but for what says how well a mode was identified: MPC, the order of
the model, and others of `INDICATORS`. `roof_sd` beside `roof` is the standard deviation of its entries.
An empty cell, or nan, is an entry that was not measured. Complex entries are written as 0.3-0.1j.
"""

import csv
import re
from collections import Counter
from collections.abc import Iterator
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from pymc_features.io.reading.labels import without_brackets
from pymc_features.io.reading.lines import LONGEST_NUMBER, Lines, to_number
from pymc_features.modal.data import find_channels, listed
from pymc_features.modal.files.quantities import (
    ALIKE,
    SPREADS,
    Identified,
    labelled_quantities,
    mode_values,
    quantity_of,
)

SEPARATORS = ("\t", ";", ",")
QUANTITIES = [
    "mode",
    "frequency",
    "freq",
    "damping",
    "omega",
    "eigenvalue",
    "zeta",
    "shape",
    "shapes",
    "order",
]
COMMENTS = ("#", "%", "//")
#: What tables of identifications have beside shapes, without blanks and brackets, in lower case.
INDICATORS = re.compile(
    "mpcw?|mpd|e?mac|msv|mcv|mcf|cmi|uml|mif|period|quality|(model)?order|(mean)?phase(deviation|scatter)?|"
    "confidence|count|clustersize|poles|test(no)?|run|setup|date|time|temperature"
)
_OF_MODE = re.compile(r"(?:f|freq|frequency|mode)[ _]?(\d+)(?:[ _]?(?:\[hz\]|\(hz\)|hz))?", re.IGNORECASE)
_COMPLEX = re.compile(r"([-+]?[^-+ij]+(?:[eE][-+]?\d+)?)([-+][^-+ij]+(?:[eE][-+]?\d+)?)[ij]", re.ASCII)


def read_table(path: Path, names: dict[str, str], wanted: list | None) -> Identified:
    """The modes of a table; `names` is what it calls quantities, `wanted` its channels, if not all others."""
    lines = Lines(path)
    rows = ((number, line) for number, line in lines if not line.startswith(COMMENTS))
    first = next(rows, None)
    if first is None:
        raise ValueError(
            f"{path.name} must hold modes, it is empty. Save a row for each mode, below a header."
        )
    separator = next((mark for mark in SEPARATORS if mark in first[1]), ",")
    header = _cells(first[1], separator, f"{path.name}, line {first[0]}")
    _check_header(path.name, header, rows, separator)
    of_modes = {k: match[1] for k, label in enumerate(header) if (match := _OF_MODE.fullmatch(label))}
    if len(of_modes) > 1 and not names:
        return _tests(path.name, header, of_modes, rows, separator)
    places = labelled_quantities(header, names, path.name)
    whole = sorted({"shapes", "shape_sd", "shapes_imaginary", "channels"} & places.keys())
    if whole:
        raise ValueError(
            f"{path.name}: each channel must have a column of its own, got {header[places[whole[0]]]!r} for "
            f"{whole[0]}. Rename it after its channel."
        )
    channels, spreads = _channels(path.name, header, places, wanted)
    quantities = {name: place for name, place in places.items() if name != "mode"}
    columns = {place: [] for of in (quantities, channels, spreads) for place in of.values()}
    entries = set(channels.values())
    labels = []
    for where, cells in _rows(path.name, rows, separator, len(header)):
        labels.append(cells[places["mode"]] if "mode" in places else "")
        for place in columns:
            columns[place].append(_number(cells[place], header[place], where, place in entries))
    if not labels:
        raise ValueError(
            f"{path.name} must hold modes, there is none below its header. Add a row for each mode."
        )
    values = mode_values({name: np.array(columns[place]) for name, place in quantities.items()}, path.name)
    return Identified(
        path.name,
        *values,
        shapes=_matrix(columns, channels),
        shape_sd=_matrix(columns, {name: spreads.get(name) for name in channels}) if spreads else None,
        channels=list(channels) or None,
        labels=labels if len(set(labels)) < len(labels) and "" not in labels else None,
    )


def _tests(file: str, header, of_modes: dict[int, str], rows, separator: str) -> Identified:
    """The modes of a table with a row for each test, its frequencies [Hz] in columns with these labels."""
    found = []
    for where, cells in _rows(file, rows, separator, len(header)):
        values = {label: _number(cells[k], header[k], where, False) for k, label in of_modes.items()}
        found += [(value, label) for label, value in values.items() if not np.isnan(value)]
    if not found:
        raise ValueError(f"{file} must hold modes, there is none below its header. Add a row for each test.")
    frequencies, labels = zip(*found, strict=True)
    return Identified(file, np.array(frequencies), labels=list(labels))


def _rows(file: str, rows, separator: str, count: int) -> Iterator[tuple[str, list[str]]]:
    """Place and cells of each row, as many as the header has."""
    for number, line in rows:
        where = f"{file}, line {number}"
        cells = _cells(line, separator, where)
        if len(cells) != count:
            raise ValueError(
                f"{where}: rows must have {count} cells like the header, got {len(cells)}. Complete or cut "
                "the row; a decimal comma must be a point."
            )
        yield where, cells


def _cells(line: str, separator: str, where: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error as error:
        raise ValueError(
            f"{where}: cells must be separated by {separator!r}, got {error}. Correct the line."
        ) from None


def _check_header(file: str, header: list[str], rows, separator: str) -> None:
    """Refuse a table without names, and one with a column for each mode."""
    if to_number(header[0]) is not None:
        raise ValueError(
            f"{file} must have the names of its columns in the first line, got the number {header[0]!r}. "
            "Write them above the numbers, frequency among them."
        )
    labels = [label for label in header[1:] if to_number(label) is None]
    if len(header) > 1 and not labels and quantity_of(header[0], file) is not None:
        raise ValueError(
            f"{file} must have a row for each mode and a column for each channel, its first line begins with "
            f"{header[0]!r} and goes on with numbers. Transpose the table."
        )


def _channels(file: str, header, places, wanted) -> tuple[dict[str, int], dict[str, int]]:
    """Columns of the channels, and of the standard deviations of their entries, by name of the channel."""
    rest = [(index, label) for index, label in enumerate(header) if index not in places.values()]
    if wanted is None:
        rest = [(index, label) for index, label in rest if not INDICATORS.fullmatch(plain(label))]
    else:
        find_channels(wanted, [without_brackets(label) or label for _, label in rest], file)
        names = set(wanted)
        rest = [(index, label) for index, label in rest if _is_wanted(label, names)]
    bare = [without_brackets(label) or label for _, label in rest]
    if "" in bare:
        index = rest[bare.index("")][0]
        raise ValueError(
            f"{file}: columns must have names, number {index + 1} of the header has none. Add one."
        )
    twice = [name for name, count in Counter(bare).items() if count > 1]
    if twice:
        raise ValueError(
            f"{file}: channels must have different names, got {listed(twice)} more than once. Rename or "
            "leave out one of each."
        )
    named = dict(zip(bare, (index for index, _ in rest), strict=True))
    spreads = {}
    for name in bare:
        base, end = _of_spread(name)
        if end and base in named:
            spreads[base] = named[name]
        elif wanted is None and (end or (close := get_close_matches(name.lower(), QUANTITIES, 1, ALIKE))):
            meant = f"a standard deviation of {base}, which is no column" if end else f"{close[0]}, misspelt"
            raise ValueError(
                f"{file}: the column {name!r} must be a channel, it looks like {meant}. Rename it, or name "
                "those that are channels by `channels`."
            )
    taken = set(spreads.values())
    channels = {name: index for name, index in named.items() if index not in taken}
    return channels, spreads


def plain(label: str) -> str:
    """A label without blanks, marks and brackets, in lower case."""
    return re.sub(r"[ _.-]", "", (without_brackets(label) or label).lower())


def _of_spread(name: str) -> tuple[str, bool]:
    """What a column is the standard deviation of: `roof` of "roof_sd" and "roof std"; else its own name."""
    base, _, end = re.sub(r"[ -](?=\w+$)", "_", name).rpartition("_")
    is_spread = bool(base) and end.lower() in SPREADS
    return (name[: len(base)], True) if is_spread else (name, False)


def _is_wanted(label: str, wanted: set[str]) -> bool:
    name = without_brackets(label) or label
    base, is_spread = _of_spread(name)
    return name in wanted or (is_spread and base in wanted)


def _matrix(columns, places: dict) -> np.ndarray | None:
    """Entries (mode, channel); NaN in the columns that are not there."""
    if not places:
        return None
    length = len(next(iter(columns.values())))
    return np.array(
        [columns[place] if place is not None else [np.nan] * length for place in places.values()]
    ).T


def _number(cell: str, label: str, where: str, may_be_complex: bool):
    """The number in a cell, NaN in an empty one."""
    number = np.nan if not cell else to_number(cell)
    if number is None and may_be_complex and len(cell) <= LONGEST_NUMBER:
        parts = _COMPLEX.fullmatch(cell.replace(" ", ""))
        numbers = [to_number(part) for part in parts.groups()] if parts else [None]
        number = None if None in numbers else complex(*numbers)
    if number is None:
        shown = cell if len(cell) <= 60 else f"{cell[:60]}..."
        raise ValueError(
            f"{where}: the column {label!r} must hold numbers, got {shown!r}. Correct it, or leave the "
            "column out by `channels`."
        )
    return number
