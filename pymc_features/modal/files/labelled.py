"""Modes under labels: in text tables, in variables of MATLAB files, JSON and mappings, in results of pyOMA2.

A table has a row for each mode, and names of columns above them:

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

Variables have the same names, and shapes as they are in print and in MATLAB: a row for each channel and a
column for each mode. JSON has no complex numbers: their imaginary parts are `shapes_imaginary`. Entries that
were not measured are null or NaN.

    {"frequency": [1.21, 3.47], "damping": [0.012, 0.010], "channels": ["floor 1", "roof"],
     "shapes": [[0.45, 1.0], [1.0, -0.4]]}

Results of pyOMA2 are read by the attributes that its documentation states; the library is not imported: `Fn`
(m,) [Hz], `Phi` (s, m), and where the algorithm gives them `Xi` (m,), `Fn_std`, `Xi_std` (m,) and `Phi_std`
(s, m). Those of merged set-ups are how much the set-ups scatter.

Pasca, D. P. and Margoni, D. F. (2024), pyOMA2, https://github.com/dagghe/pyOMA2.
"""

import csv
import json
import re
from collections import Counter
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from pymc_features._checks import require
from pymc_features.io.reading.labels import Label, unit_of, without_brackets
from pymc_features.io.reading.lines import LONGEST_NUMBER, Lines, decoded, shortened, to_number
from pymc_features.modal.data import demand, find_channels, listed, refusal
from pymc_features.modal.files.quantities import (
    ALIKE,
    NAMES,
    PER_MODE,
    SPREADS,
    labelled_quantities,
    mode_values,
    numbers_in,
    quantity_of,
)

MOST_JSON = 64 * 2**20  # bytes
SEPARATORS = ("\t", ";", ",")
QUANTITIES = ["mode", "order", "shape", "shapes", "frequency", "freq", "omega", "eigenvalue", "damping"]
QUANTITIES += ["zeta"]
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
            separator = separator or next((mark for mark in SEPARATORS if mark in line), ",")
            try:
                cells = next(csv.reader([line], delimiter=separator), [])
            except csv.Error as error:
                what = f"{file}, line {number}: cells must be separated by {separator!r}"
                raise refusal(what, error, "Correct the line.") from None
            rows.append((f"{file}, line {number}", [cell.strip() for cell in cells]))
    require(rows, f"{file} must hold modes, it is empty. Save a row for each mode, below a header.")
    (_, header), *body = _upright(file, rows)
    what = f"{file} must have the names of its columns in the first line"
    got, advice = f"the number {header[0]!r}", "Write them above the numbers, frequency among them."
    demand(to_number(header[0]) is None, what, got, advice)
    for where, cells in body:
        advice = "Complete or cut the row; a decimal comma must be a point."
        what = f"{where}: rows must have {len(header)} cells like the header"
        demand(len(cells) == len(header), what, len(cells), advice)

    def column(place: int, may_be_complex: bool = False) -> np.ndarray:
        return np.array([_number(cells[place], header[place], at, may_be_complex) for at, cells in body])

    below = "{} must hold modes, there is none below its header. Add a row for each {}."
    of_modes = [(match[1], k) for k, label in enumerate(header) if (match := _OF_MODE.fullmatch(label))]
    if len(of_modes) > 1 and not names:  # a row for each test
        labels = dict(of_modes)
        table = np.array([column(k) for k in labels.values()]).T
        there = ~np.isnan(table)
        require(there.any(), below.format(file, "test"))
        return {"frequencies": table[there], "labels": np.tile([*labels], (len(body), 1))[there].tolist()}
    places = labelled_quantities(header, names, file)
    for name in sorted({"shapes", "shape_sd", "shapes_imaginary", "channels"} & places.keys()):
        got, advice = f"{header[places[name]]!r} for {name}", "Rename it after its channel."
        raise refusal(f"{file}: each channel must have a column of its own", got, advice)
    channels, spreads, parts = _channels(file, header, places, wanted)
    mode = places.pop("mode", None)
    require(body, below.format(file, "mode"))
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
        columns = [column(spreads[name]) if name in spreads else unknown for name in channels]
        found["shape_sd"] = np.array(columns).T
    return found


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
    empty = [k for name, k in named if not name]
    what = f"columns must have names, number {[*empty, 0][0] + 1} of the header has none. Add one."
    require(not empty, f"{file}: {what}")
    twice = [name for name, count in counts.items() if count > 1]
    what, got = f"{file}: channels must have different names", f"{listed(twice)} more than once"
    demand(not twice, what, got, "Rename or leave out one of each.")
    channels, spreads = dict(named), {}
    for name, place in named:
        unit = unit_of(Label.of(header[place]).unit)
        is_other = unit is not None and unit.quantity in ("frequency", "time", "angle", "temperature")
        require(
            wanted is not None or not is_other,
            f"{file}: the column {header[place]!r} must be a channel, its unit is one of "
            f"{is_other and unit.quantity}. Leave it out, or name those that are channels by `channels`.",
        )
        base = _of_spread(name)
        if base in counts:
            first = spreads.setdefault(base, place)
            what, got = f"the standard deviation of {base} must", f"{header[first]!r} and {name!r}"
            demand(first == place, f"{file}: {what} be there once", got, "Leave out one of them.")
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
        unit, label = unit_of(Label.of(header[k]).unit, "angle"), f"the phase {header[k]!r}"
        what = f"{file} must say whether {label} is in degrees or radians"
        require(kind != "phase" or unit, f"{what}. Write [deg] or [rad] behind its name.")
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
    what, got = f"{where}: the column {label!r} must hold numbers", cell[:60] + "..." * (len(cell) > 60)
    advice = "Correct it, or leave the column out by `channels`."
    demand(number is not None, what, repr(got), advice)
    return number


# --- named variables ------------------------------------------------------------------------------------


def read_json_modes(path: Path, names: dict[str, str]) -> dict:
    """Modes in the object of a JSON file."""

    def once(pairs: list) -> dict:
        require(len(found := dict(pairs)) == len(pairs), "a name is there twice")
        return found

    size, what = path.stat().st_size, f"{path.name} must have at most {MOST_JSON // 2**20} MiB"
    demand(size <= MOST_JSON, what, f"{size} bytes", "Save the modes alone, or as .mat.")
    try:
        found = json.loads(decoded(path.read_bytes()), object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        what = f"it cannot be read ({shortened(error)}). Correct it."
        raise ValueError(f"{path.name} must be a JSON file, {what}") from None
    what, got = f"{path.name} must hold one JSON object of named arrays", f"a {type(found).__name__}"
    demand(isinstance(found, dict), what, got, "Give them names, frequency among them.")
    for key in found:
        close = get_close_matches(key.lower(), NAMES, 1, ALIKE)
        looks = f"looks like {close[0]}, misspelt" if close else "is no name"
        is_known = key in names.values() or quantity_of(key, path.name) is not None
        what = f"the key {key!r} {looks}. Correct it, rename it, or say by `names` what it is."
        require(is_known or (key and not close), f"{path.name}: {what}")
    return from_variables(found, path.name, names)


def from_variables(variables: Mapping, source: str, names: dict[str, str]) -> dict:
    """Modes in a mapping of names to arrays."""
    labels, contents = [str(label) for label in variables], list(variables.values())
    flat = not labels or not all(isinstance(value, Mapping) for value in contents)
    what, advice = f"{source} must hold named arrays", "Pass one of these, read by yourself, instead of"
    demand(flat, what, f"objects inside: {listed(labels)}", f"{advice} the file.")
    places = labelled_quantities(labels, names, source)
    given = {name: contents[place] for name, place in places.items() if name != "mode"}
    found = mode_values(given, source)

    def matrix(name: str) -> np.ndarray | None:
        """Entries (mode, channel) of a matrix (channel, mode), or of one vector for one mode."""
        count, what = found["frequencies"].size, f"{source}: {name} must"
        rows = "a row for each channel and a column for each"
        otherwise = f"{what} be a matrix of numbers with {rows} mode, got something else."
        array = numbers_in(given[name], "iufc", otherwise)
        if array.ndim == 1 and count == 1:
            array = array[:, None]
        turned = array.ndim == 2 and array.shape[0] == count
        advice = "Transpose it." if turned else "Pass `names` if another variable holds them."
        is_whole = array.ndim == 2 and array.shape[1] == count
        demand(is_whole, f"{what} have {rows} of the {count} modes", f"shape {array.shape}", advice)
        return array.T

    arrays = ("shapes", "shapes_imaginary", "shape_sd")
    found |= {name: matrix(name) for name in arrays if name in given}
    if (imaginary := found.pop("shapes_imaginary", None)) is not None:
        shapes = found.get("shapes")
        alike = shapes is not None and shapes.shape == imaginary.shape and shapes.dtype.kind != "c"
        what = f"{source}: shapes_imaginary must stand beside real shapes of its size"
        demand(alike, what, "other ones", "Save both parts.")
        found["shapes"] = shapes + 1j * imaginary
    if (channels := given.get("channels")) is not None:  # a list, or the rows of a text
        found["channels"] = np.ravel(np.asarray(channels, dtype=object)).tolist()
        are_texts = all(isinstance(name, str) for name in found["channels"])
        got, advice = type(channels).__name__, "Pass `channels` instead."
        demand(are_texts, f"{source}: channels must be texts", got, advice)
    return found


# --- results of pyOMA2 -------------------------------------------------------------------------------

OF_OMA = {"frequency": "Fn", "damping": "Xi", "shapes": "Phi"}
OF_OMA |= {"frequency_sd": "Fn_std", "damping_sd": "Xi_std", "shape_sd": "Phi_std"}


def is_oma(source) -> bool:
    """Whether an object is a result, or has one or several."""
    if isinstance(source, Mapping):
        return bool(source) and all(hasattr(value, "Fn") for value in source.values())
    return hasattr(source, "Fn") or hasattr(source, "result")


def read_oma(source) -> dict:
    """Modes of a result, of an algorithm that has one, or of merged set-ups."""
    result = source if hasattr(source, "Fn") or isinstance(source, Mapping) else source.result
    name = type(source).__name__
    if isinstance(result, Mapping):
        got = f"{name} with {listed([repr(key) for key in result])}"
        advice = "Pass one, such as source.result[...]."
        demand(len(result) == 1, "`source` must be one result", got, advice)
        [result] = result.values()
    is_picked = getattr(result, "Fn", None) is not None and getattr(result, "Phi", None) is not None
    got, advice = f"{name} without frequencies or shapes", "Call `mpe` of its set-up first."
    demand(is_picked, "`source` must have picked modes", got, advice)
    found = {ours: getattr(result, theirs, None) for ours, theirs in OF_OMA.items()}
    return from_variables({ours: values for ours, values in found.items() if values is not None}, name, {})
