"""Modes in a text table: a row for each mode, and columns with names above them.

    frequency [Hz],frequency_sd,damping,floor 1,floor 2,roof
    1.21,0.01,0.012,0.33,0.71,1.0
    3.47,0.02,0.010,0.88,0.41,-0.9

A column `mode` that names a mode in several rows makes them identifications of one. A table with a row for
each test has a column for each mode in place of `frequency`: f1 [Hz], f2 [Hz]; other columns are not read.

Columns that are no quantity are channels, but for what says how well a mode was identified: MPC, the order of
the model, and others of `INDICATORS`. `roof_sd` beside `roof` is the standard deviation of its entries.
An empty cell, or nan, is an entry that was not measured. Complex entries are written as 0.3-0.1j, or in two
columns: `roof real` and `roof imag`, or `roof mag` (or `roof`) and `roof phase [deg]`. A table that lies on
its side, with names of quantities and channels in its first column, is turned.
"""

import csv
import re
from collections import Counter
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from pymc_features.io.reading.labels import Label, unit_of, without_brackets
from pymc_features.io.reading.lines import LONGEST_NUMBER, Lines, to_number
from pymc_features.modal.data import find_channels, listed, refusal
from pymc_features.modal.files.quantities import (
    ALIKE,
    PER_MODE,
    SPREADS,
    labelled_quantities,
    mode_values,
    quantity_of,
)

SEPARATORS = ("\t", ";", ",")
QUANTITIES = [
    "mode",
    "order",
    "shape",
    "shapes",
    "frequency",
    "freq",
    "omega",
    "eigenvalue",
    "damping",
    "zeta",
]
COMMENTS = ("#", "%", "//")
#: What tables of identifications have beside shapes, without blanks and brackets, in lower case.
INDICATORS = re.compile(
    "mpcw?|mpd|e?mac|msv|mcv|mcf|cmi|uml|mif|period|quality|(model)?order|(mean)?phase(deviation|scatter)?|"
    "confidence|count|clustersize|poles|test(no)?|run|setup|date|time|temperature"
)
#: Which part of a complex entry a column is, by the end of its name.
PARTS = {"magnitude": "mag magnitude amp amplitude abs modulus", "phase": "phase angle arg"}
PARTS |= {"real": "re real", "imaginary": "im imag imaginary"}
PARTS = {word: part for part, words in PARTS.items() for word in words.split()}
_OF_MODE = re.compile(r"(?:f|freq|frequency|mode)[ _]?(\d+)(?:[ _]?(?:\[hz\]|\(hz\)|hz))?", re.IGNORECASE)
_COMPLEX = re.compile(r"([-+]?[^-+ij]+(?:[eE][-+]?\d+)?)([-+][^-+ij]+(?:[eE][-+]?\d+)?)[ij]", re.ASCII)


def read_table(path: Path, names: dict[str, str], wanted: list | None) -> dict:
    """The modes of a table; `names` is what it calls quantities, `wanted` its channels, if not all others."""
    file, separator, rows = path.name, None, []  # place and cells of each row, the header first
    for number, line in Lines(path):
        if not line.startswith(COMMENTS):
            where = f"{file}, line {number}"
            separator = separator or next((mark for mark in SEPARATORS if mark in line), ",")
            rows.append((where, _cells(line, separator, where)))
    if not rows:
        raise ValueError(f"{file} must hold modes, it is empty. Save a row for each mode, below a header.")
    (_, header), *body = _upright(file, rows)
    _check_header(file, header)
    for where, cells in body:
        if len(cells) != len(header):
            advice = "Complete or cut the row; a decimal comma must be a point."
            raise refusal(f"{where}: rows must have {len(header)} cells like the header", len(cells), advice)

    def column(place: int, may_be_complex: bool = False) -> np.ndarray:
        return np.array([_number(cells[place], header[place], at, may_be_complex) for at, cells in body])

    below = "{} must hold modes, there is none below its header. Add a row for each {}."
    of_modes = {k: match[1] for k, label in enumerate(header) if (match := _OF_MODE.fullmatch(label))}
    if len(of_modes) > 1 and not names:  # a row for each test
        labels = {label: k for k, label in of_modes.items()}
        table = np.array([column(k) for k in labels.values()]).T
        there = ~np.isnan(table)
        if not there.any():
            raise ValueError(below.format(file, "test"))
        return {"frequencies": table[there], "labels": np.tile(list(labels), (len(body), 1))[there].tolist()}
    places = labelled_quantities(header, names, file)
    whole = sorted({"shapes", "shape_sd", "shapes_imaginary", "channels"} & places.keys())
    if whole:
        got = f"{header[places[whole[0]]]!r} for {whole[0]}"
        what = f"{file}: each channel must have a column of its own"
        raise refusal(what, got, "Rename it after its channel.")
    channels, spreads, parts = _channels(file, header, places, wanted)
    mode = places.pop("mode", None)
    if not body:
        raise ValueError(below.format(file, "mode"))
    found = mode_values({name: column(place) for name, place in places.items()}, file)
    labels = [] if mode is None else [cells[mode] for _, cells in body]
    if len({*labels}) < len(labels) and "" not in labels:
        found["labels"] = labels
    if channels:
        found["channels"] = list(channels)
        entries = {name: column(place, True) for name, place in channels.items()}
        for name in parts.keys() & channels.keys():
            place, unit = parts[name]
            other = column(place)
            entries[name] = entries[name] * np.exp(1j * unit * other) if unit else entries[name] + 1j * other
        found["shapes"] = np.array(list(entries.values())).T
    if channels and spreads:
        unknown = np.full(len(body), np.nan)
        found["shape_sd"] = np.array(
            [column(spreads[name]) if name in spreads else unknown for name in channels]
        ).T
    return found


def _cells(line: str, separator: str, where: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error as error:
        what = f"{where}: cells must be separated by {separator!r}"
        raise refusal(what, error, "Correct the line.") from None


def _upright(file: str, rows: list[tuple[str, list[str]]]) -> list[tuple[str, list[str]]]:
    """Place and cells of rows with a mode each: those given, or the columns of a table on its side."""
    cells = [row for _, row in rows]
    of_quantity = [
        quantity_of(row[0], file) in PER_MODE and all(to_number(cell) is not None for cell in row[1:])
        for row in cells
    ]
    if not any(of_quantity) or len({len(row) for row in cells}) > 1 or len(cells[0]) == 1:
        return rows
    header, *columns = map(list, zip(*cells, strict=True))
    header = header if of_quantity[0] else ["mode", *header[1:]]  # below the names of the modes
    return [(file, header), *((f"{file}, column {k}", column) for k, column in enumerate(columns, 2))]


def _check_header(file: str, header: list[str]) -> None:
    """Refuse a table without names."""
    if to_number(header[0]) is not None:
        what = f"{file} must have the names of its columns in the first line"
        advice = "Write them above the numbers, frequency among them."
        raise refusal(what, f"the number {header[0]!r}", advice)


def _channels(file: str, header, places, wanted) -> tuple[dict[str, int], dict[str, int], dict]:
    """Columns of the channels, of the standard deviations of their entries, and of second parts, by name."""
    named = [(without_brackets(label) or label, k) for k, label in enumerate(header)]
    named = [(name, k) for name, k in named if k not in places.values()]
    named, parts = _complex_columns(file, header, named)
    if wanted is None:
        named = [entry for entry in named if not INDICATORS.fullmatch(re.sub("[ _.-]", "", entry[0].lower()))]
    else:
        find_channels(wanted, [name for name, _ in named], file)
        asked = set(wanted)
        named = [entry for entry in named if not asked.isdisjoint((entry[0], _of_spread(entry[0])))]
    counts = Counter(name for name, _ in named)
    if "" in counts:
        k = next(k for name, k in named if not name)
        raise ValueError(f"{file}: columns must have names, number {k + 1} of the header has none. Add one.")
    twice = [name for name, count in counts.items() if count > 1]
    if twice:
        what, advice = f"{file}: channels must have different names", "Rename or leave out one of each."
        raise refusal(what, f"{listed(twice)} more than once", advice)
    channels, spreads = dict(named), {}
    for name, place in named:
        unit = unit_of(Label.of(header[place]).unit)
        if wanted is None and unit and unit.quantity in ("frequency", "time", "angle", "temperature"):
            what = (
                f"{file}: the column {header[place]!r} must be a channel, its unit is one of {unit.quantity}"
            )
            raise ValueError(f"{what}. Leave it out, or name those that are channels by `channels`.")
        base = _of_spread(name)
        if base in spreads:
            what = f"{file}: the standard deviation of {base} must be there once"
            raise refusal(what, f"{header[spreads[base]]!r} and {name!r}", "Leave out one of them.")
        if base in counts:
            spreads[base] = place
            del channels[name]
        elif name in parts:
            continue
        elif wanted is None and (base or (close := get_close_matches(name.lower(), QUANTITIES, 1, ALIKE))):
            meant = f"a standard deviation of {base}, which is no column" if base else f"{close[0]}, misspelt"
            raise ValueError(
                f"{file}: the column {name!r} must be a channel, it looks like {meant}. Rename it, or name "
                "those that are channels by `channels`."
            )
    return channels, spreads, parts


def _complex_columns(file: str, header, named) -> tuple[list[tuple[str, int]], dict[str, tuple[int, float]]]:
    """Names with the column of the first part of their entries; column and unit [rad] of the second.

    The unit is 0 where the parts are real and imaginary.
    """
    kinds = {k: (name, None) for name, k in named}
    for name, k in named:
        base, _, end = re.sub("[ .-]", "_", name).rpartition("_")
        if base and end.lower() in PARTS:
            kinds[k] = name[: len(base)], PARTS[end.lower()]
    found, places = {}, {pair: k for k, pair in kinds.items()}
    for (base, kind), k in places.items():
        firsts = {"phase": ("magnitude", None), "imaginary": ("real",)}.get(kind, ())
        first = next((places[base, part] for part in firsts if (base, part) in places), None)
        if first is None:
            continue
        unit = unit_of(Label.of(header[k]).unit, "angle")
        if kind == "phase" and unit is None:
            what = f"{file} must say whether the phase {header[k]!r} is in degrees or radians"
            raise ValueError(f"{what}. Write [deg] or [rad] behind its name.")
        found[first] = base, (k, unit.factor if kind == "phase" else 0.0)
    seconds = [k for _, (k, _) in found.values()]
    kept = [(found[k][0] if k in found else name, k) for name, k in named if k not in seconds]
    return kept, dict(found.values())


def _of_spread(name: str) -> str | None:
    """What a column is the standard deviation of: `roof` of "roof_sd" and "roof std"; None of others."""
    base, _, end = re.sub(r"[ -](?=\w+$)", "_", name).rpartition("_")
    return name[: len(base)] if base and end.lower() in SPREADS else None


def _number(cell: str, label: str, where: str, may_be_complex: bool):
    """The number in a cell, NaN in an empty one."""
    number = np.nan if not cell else to_number(cell)
    if number is None and may_be_complex and len(cell) <= LONGEST_NUMBER:
        parts = _COMPLEX.fullmatch(cell.replace(" ", ""))
        numbers = [to_number(part) for part in parts.groups()] if parts else [None]
        number = None if None in numbers else complex(*numbers)
    if number is None:
        shown = cell if len(cell) <= 60 else f"{cell[:60]}..."
        advice = "Correct it, or leave the column out by `channels`."
        raise refusal(f"{where}: the column {label!r} must hold numbers", repr(shown), advice)
    return number
