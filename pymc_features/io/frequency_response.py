"""Frequency response functions from files of analysers and modal programs, as one array with its labels.

Arguments say what a file leaves open of parts of numbers, units and places, and must not contradict it.
"""

import re
from collections.abc import Sequence
from itertools import product
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pymc_features import _checks as checks
from pymc_features._checks import listed
from pymc_features.io.formats import libraries
from pymc_features.io.formats.matlab import load_variables
from pymc_features.io.formats.text import read_columns
from pymc_features.io.reading.labels import SI, Label, role_of, unit_of
from pymc_features.io.reading.lines import Lines, by_library
from pymc_features.io.reading.recording import Request

if TYPE_CHECKING:
    import xarray as xr

FUNCTION, COHERENCE = (4, 5), 6  # types of data sets 58, of which 5 is transmissibility
WORDS = {"real": "real re", "imaginary": "imaginary imag im", "magnitude": "magnitude mag amplitude abs"}
WORDS |= {"phase": "phase angle", "coherence": "coherence coh"}
PARTS = {word: part for part, words in WORDS.items() for word in words.split()}
ANGLES = {"deg": np.pi / 180.0, "°": np.pi / 180.0, "rad": 1.0}
#: Quantity of the response by the name of a function.
NAMES = {"accelerance": "acceleration", "inertance": "acceleration", "mobility": "velocity"}
NAMES |= {"receptance": "displacement", "compliance": "displacement"}
ENDS = NAMES.values(), ("force", "acceleration")  # what response and excitation may be
PLACE = re.compile(r"(?<![A-Za-z\d.])(\d+):?([+-]?)(R?[XYZ])(?![A-Za-z])", re.IGNORECASE)
COMPLEX = re.compile(r"\d[ij]\b")
DECIBEL = re.compile(r"(?:dB(?:\s+re\s+([\d.]+(?:e[-+]?\d+)?))?)?\s*", re.IGNORECASE)
#: Spellings of a ratio of units, and the groups that are response and excitation.
RATIOS = {
    r"\(1/([^()]+)\)\s*\*?\s*\(?([^()]+)\)?": (2, 1),  # (1/N)*(m/s²)
    r"\(?([^()]+?)\)?\s*/?\s*\(([^()]+)\)": (1, 2),  # (m/s²)(N), g/(m/s²)
    r"\(?([^()]+?)\)?\s*/\s*([^()/]+)": (1, 2),  # (m/s²)/N, m/s²/N
}
SAY = 'Say so by `columns`, as in "real", "magnitude [dB]" or "phase [deg]".'
APART = "Correct labels, or read others apart."


class Function(NamedTuple):
    """A function as a file states it."""

    source: str  # for messages
    frequency: np.ndarray  # (line,) [Hz]
    values: np.ndarray  # (line,)
    units: str  # a ratio
    places: tuple[str, ...]  # response and reference
    kinds: tuple[str, ...]  # quantities of response and excitation
    coherence: np.ndarray | float = np.nan  # (line,)


def read_frequency_response(
    files: str | PathLike | Sequence[str | PathLike],
    *,
    units: str | None = None,
    response: str | Sequence[str] | None = None,
    reference: str | Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
) -> "xr.Dataset":
    """Read frequency response functions of one file or several, in SI units.

    Parameters
    ----------
    files : path or sequence of paths
        Universal Files (data sets 58 of types 4, 5 and 6, coherence), text as of SignalCalc, CSV, MATLAB,
        HDF5 or ``.npz``. Tables have a column of frequencies and complex numbers, real and imaginary parts or
        magnitudes and phases; arrays (response, reference, frequency) likewise, or frequencies first.
    units : str, optional
        A ratio such as "(m/s^2)/N", "g/N" or "mm/s/lbf"; "g/g" under a motion of the base.
    response, reference : str or sequence of str, optional
        Node and direction, "5:+z", or name of a channel: one for all, one for each function in order, or for
        each row and column of an array. Labels of columns, "5:+z/3:+z real", and names of files,
        ``5+z_3+z.txt``, state both.
    columns : sequence of str, optional
        Labels of the columns of tables, such as "frequency [Hz]", "magnitude [dB re 1 g/N]", "phase [deg]".

    Returns
    -------
    xarray.Dataset (response, reference, frequency [Hz])
        As of `signals.frequency_response`, with `coherence` where files have it, and without `variance`. In
        `attrs` are `n_averages` 0, `decay` 0, and `duration`, `dt`, `blow` NaN: set what is known.

    Raises
    ------
    FileNotFoundError, ImportError, ValueError, TypeError
        If a file is broken, contradicts others or an argument, or needs pyuff; if a pair is there twice or
        missing, or something needed is said nowhere.

    Warns
    -----
    UserWarning
        If lines are missing in an even axis, or units of a file are not known and the argument counts.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "beam.csv"
    ...     _ = path.write_text("f [Hz],5:+z/3:+z magnitude [dB re 1 g/N],phase [deg]\\n1,20,0\\n2,20,90\\n")
    ...     read_frequency_response(path)["frequency_response"].values.round(9)
    array([[[98.1 +0.j ,  0. +98.1j]]])
    """
    units = None if units is None else checks.check_text(units, "units", 'As "(m/s^2)/N".')
    paths = [files] if isinstance(files, str | PathLike) else checks.as_list(files) or []
    functions = [one for path in paths for one in _read(checks.check_file(path, "files"), columns)]
    _must(functions, "`files`", "be a path, or several", checks.shown(files), "Name files.")
    for source, f, values, *_ in functions:
        rises = values.shape == f.shape and f.size > 1 and (np.diff(f) > 0.0).all()
        _must(rises, source, "have values at two or more rising frequencies", f"{values.size} at {f.size}")
        _must(f[0] >= 0.0, source, "have no negative frequencies", f"{f[0]:g} Hz", "Cut it to the others.")
        _must(np.isfinite(values).all(), source, "be finite", f"NaN at {f[~np.isfinite(values)][:1]} Hz")
        _must(np.imag(values).any(), source, "be complex", "real parts alone")
        steps = np.diff(f) / np.median(np.diff(f))
        is_even = (np.abs(steps - 1.0) < 0.01).mean() > 0.8
        if (missing := f[1:][(values[1:] == 0.0) | (is_even & (steps > 1.5))]).size:
            text = f"{source}: lines at or before {listed(missing, 5)} Hz are missing. Were they cut out?"
            checks.warn_caller(text)
    return _dataset(functions, _labels(functions, response, reference), units)


def _must(holds, source: str, be: str, got, advice: str = "Export it again.") -> None:
    checks.require(holds, f"{source} must {be}, got {got}. {advice}")


def _read(path: Path, columns) -> list[Function]:
    if re.match(libraries.UNIVERSAL, path.read_bytes()):
        return _universal(path)
    if path.suffix.lower() in (".mat", ".h5", ".hdf5", ".npz"):
        return _of_arrays(path, load_variables(path))
    return _table(path, columns)


def _universal(path: Path) -> list[Function]:
    """Functions of data sets 58, with the coherences that stand beside them."""
    _, sets = libraries.universal_sets(path)
    kinds = listed([f"type {kind}" for kind in dict.fromkeys(one["func_type"] for one in sets)])
    functions, coherences = [], {}
    for one in [one for one in sets if one["func_type"] in (*FUNCTION, COHERENCE)]:
        places = _place(one, "rsp"), _place(one, "ref")
        source = f"{path.name}, {'/'.join(places)}"
        values, x = libraries.numbers_of(one, source)
        if one["func_type"] == COHERENCE:
            coherences[places] = values.real
            continue
        line = np.polyval(np.polyfit(np.arange(x.size), x, 1), np.arange(x.size))
        rounded = not one["abscissa_spacing"] and np.abs(x - line).max() < 1e-5 * x[-1]  # six digits
        hertz, over, under = (libraries.unit_on(one, axis) for axis in ("abscissa", "ordinate", "orddenom"))
        codes = one["ordinate_spec_data_type"], one["orddenom_spec_data_type"]
        says = tuple(libraries.QUANTITY_OF_TYPE.get(code) or "" for code in codes)
        units = f"({over})/({under})" if over and under else over
        f = (line if rounded else x) * _hertz(hertz, source)
        functions.append(Function(source, f, values, units, places, says))
    must = "hold frequency response functions, data sets 58 of type 4"
    _must(functions, path.name, must, kinds, "Read time histories by `read_channels`.")
    return [one._replace(coherence=coherences.get(one.places, np.nan)) for one in functions]


def _place(one: dict, end: str) -> str:
    """Node and direction of an end of a function, or the name of its channel; empty if there is neither."""
    node, direction, name = one[f"{end}_node"], one[f"{end}_dir"], one[f"{end}_ent_name"].strip()
    if node > 0 and 0 < abs(direction) <= len(libraries.AXES):
        return f"{node}:{'-' if direction < 0 else '+'}{libraries.AXES[abs(direction) - 1].lower()}"
    return name if name.lower() != "none" else ""


def _hertz(unit: str, source: str) -> float:
    """Hertz in the unit of frequencies, which is hertz where nothing is said."""
    known = unit_of(unit or "Hz", "frequency")
    _must(known or unit == "rad/s", source, "have frequencies in Hz or rad/s", repr(unit))
    return known.factor if known else 0.5 / np.pi


def _table(path: Path, columns) -> list[Function]:
    """Functions in columns of a text file; SignalCalc writes the unit of all below the labels."""
    lines, units = Lines(path).whole, ""
    if first := next((k for k, line in enumerate(lines[:60]) if COMPLEX.search(line)), 0):
        cut = next((mark for mark in "\t;," if mark in lines[first]), None)
        labels = [Label.of(cell.strip()) for cell in lines[first - 1].split(cut)]
        with by_library("NumPy", "", path, "CSV"):
            rows = [line.replace("i", "j").replace(" ", "" if cut else " ") for line in lines[first:]]
            values = np.loadtxt(rows, np.complex128, delimiter=cut, ndmin=2)
    else:
        _, labels, values, *_ = read_columns(path, Request())
        units = next((line.split("\t")[1].strip() for line in lines[:60] if line.startswith("Hz\t")), "")
    said = listed([label.text for label in labels if label.text])
    texts = checks.check_texts([] if columns is None else columns, "columns", "labels of columns")
    by_argument = [Label.of(text) for text in texts]
    for a, b in zip(labels, by_argument, strict=False):
        alike = all(not x or not y or x == y for x, y in ((_part(a), _part(b)), (a.unit, b.unit)))
        _must(alike, "`columns`", f"say what {path.name} does, {a.text!r}", repr(b.text), "Leave them out.")
    labels = by_argument or labels
    at = next((k for k, label in enumerate(labels) if _is_frequency(label.name)), None)
    complete, what = at is not None and len(labels) == values.shape[1], f"each of {values.shape[1]} columns"
    _must(complete, path.name, f'have a label of {what}, one "frequency"', said, SAY)
    parts = [(label, values[:, k]) for k, label in enumerate(labels) if k != at]
    frequency = values[:, at].real * _hertz(labels[at].unit or "", path.name)
    return _functions(path, frequency, parts, units)


def _of_arrays(path: Path, arrays: dict) -> list[Function]:
    """Functions in arrays, beside a vector of frequencies and a text `units`."""
    arrays = {name: np.squeeze(np.asarray(array)) for name, array in arrays.items()}
    name = next((name for name, array in arrays.items() if array.ndim == 1 and _is_frequency(name)), None)
    _must(name, path.name, "hold a vector `frequency`", listed(list(arrays)), "Add it.")
    frequency, parts = arrays.pop(name), []
    for text, array in arrays.items():
        if array.dtype.kind in "iufc" and array.ndim and frequency.size in (array.shape[0], array.shape[-1]):
            last = array if array.shape[-1] == frequency.size else np.moveaxis(array, 0, -1)
            parts.append((Label.of(text.replace("_", " ")), last))
    return _functions(path, frequency, parts, str(np.ravel(arrays.get("units", ""))[0]))


def _is_frequency(name: str) -> bool:
    return name.lower() == "f" or role_of(name) == "frequency"


def places_in(text: str) -> list[str]:
    """Places that a text names, as node:direction."""
    return [f"{node}:{sign or '+'}{axis.lower()}" for node, sign, axis in PLACE.findall(text)]


def _part(label: Label) -> str:
    """The part of a complex number that a label names, or coherence; empty if none."""
    return next((PARTS[word] for word in re.split("[^a-z]+", label.name.lower()) if word in PARTS), "")


def _functions(path: Path, frequency: np.ndarray, parts: list, units: str) -> list[Function]:
    """Functions of labelled parts (..., frequency), which have a name in common, or follow it without one."""
    groups: list[tuple[str, dict]] = []
    for label, values in parts:
        words = [word for word in label.name.split() if word.lower() not in {*PARTS, "db", "deg", "rad"}]
        part, name = _part(label), "/".join(places_in(label.name)) or " ".join(words)
        same = [group for title, group in groups if part and part not in group and name in ("", title)]
        if not same:
            groups.append((name, {}))
        (same or [groups[-1][1]])[-1][part] = label, values
    functions = []
    for name, group in groups:
        source = f"{path.name}, {name}" if name else path.name
        stated, values = _complex(group, source)
        places = next((tuple(p) for p in (places_in(name), places_in(path.stem)) if len(p) == 2), ("", ""))
        says = tuple(NAMES[word] for word in NAMES if word in name.lower())
        gamma = group["coherence"][1].real if "coherence" in group else np.full(values.shape, np.nan)
        for k in np.ndindex(values.shape[:-1]):
            functions.append(Function(source, frequency, values[k], stated or units, places, says, gamma[k]))
    return functions


def _complex(group: dict, source: str) -> tuple[str, np.ndarray]:
    """Units and values of a function of its parts."""
    if "" in group:
        return group[""][0].unit or "", group[""][1]
    pairs = [pair for pair in (("real", "imaginary"), ("magnitude", "phase")) if {*pair} <= {*group}]
    must = "have complex numbers, real and imaginary parts, or magnitude and phase"
    _must(pairs, source, must, f"{' and '.join(group)} alone", SAY)
    (label, values), (other, second) = (group[part] for part in pairs[0])
    units = label.unit or other.unit or ""
    if pairs[0][0] == "real":
        return units, values + 1j * second
    turn = next((ANGLES[word] for word in ANGLES if word in other.text.lower()), None)
    _must(turn, source, "say whether its phase is in deg or rad", repr(other.text), SAY)
    level, units = DECIBEL.match(label.unit or ""), label.unit or ""
    if "db" in re.split("[^a-z]+", label.text.lower()):
        units, values = units[level.end() :], 10.0 ** (values / 20.0) * float(level[1] or 1.0)
    must = "have magnitudes that are not negative"
    _must((values.real >= 0.0).all(), source, must, f"{values.real.min():g}, as of dB", SAY)
    return units, values * np.exp(1j * turn * second)


def _labels(functions: list[Function], response, reference) -> list[tuple[str, str]]:
    """Places of functions, which they or the arguments state."""
    n, ends, choices, places = len(functions), {"response": response, "reference": reference}, [], []
    for name, labels in ends.items():
        texts = checks.check_texts([] if labels is None else labels, name, "places such as '5:+z'")
        choices.append([(places_in(text) or [text])[0] for text in texts] or [""])
    sizes = [len(labels) for labels in choices]
    is_grid, what = sizes[0] * sizes[1] == n, f"one place, or one for each of {n} functions"
    checks.require(is_grid or {*sizes} <= {1, n}, checks.message("response, reference", what, sizes))
    pairs = product(*choices) if is_grid else zip(*(x * (n // len(x)) for x in choices), strict=True)
    for one, pair in zip(functions, pairs, strict=True):
        places.append(tuple(stated or said for stated, said in zip(one.places, pair, strict=True)))
        for name, stated, said, place in zip(ends, one.places, pair, places[-1], strict=True):
            got = f"{said!r}, {one.source} states {stated!r}"
            be = "be the place of the function, such as '5:+z'"
            _must(place and said in ("", place), f"`{name}`", be, got, "")
    return places


def _ratio(text: str) -> tuple[str, str, float] | None:
    """SI units of response and excitation of a ratio, and the factor to them; None where it is none."""
    for pattern, groups in RATIOS.items():
        if match := re.fullmatch(pattern, text):
            y, x = (unit_of(match[k], *kinds) for k, kinds in zip(groups, ENDS, strict=True))
            if y and x:
                return SI[y.quantity], SI[x.quantity], y.factor / x.factor
    return None


def _in_si(one: Function, units: str | None) -> tuple[str, str, float]:
    """SI units of response and excitation of a function, the factor to them, by the file or the argument."""
    stated, said = _ratio(one.units), _ratio(units or "")
    ratio, got = stated or said, f"{checks.shown(units)}, {one.source} states {one.units!r}"
    alike = ratio and said in ((None, ratio) if units is None else (ratio,))
    _must(alike, "`units`", 'be a ratio such as "(m/s^2)/N", and that of the file', got, "")
    if one.units and not stated:
        text = f"states the units {one.units!r}; the argument units={units!r} is used"
        checks.warn_caller(f"{one.source} {text}.")
    is_so = all(not kind or SI.get(kind) == unit for kind, unit in zip(one.kinds, ratio, strict=False))
    be, got = f"be {' per '.join(one.kinds)} as it says", f"units {one.units or units}"
    _must(is_so, one.source, be, got, "Correct one of them.")
    return ratio


def _dataset(functions: list[Function], places: list, units: str | None) -> "xr.Dataset":
    """All functions as one array in SI units."""
    from pymc_features.signals.frequency_response import dataset  # xarray is slow to import

    kinds, f = [_in_si(one, units) for one in functions], functions[0].frequency
    quantities = sorted({f"({y})/({x})" for y, x, _ in kinds})
    _must(len(quantities) == 1, "Functions", "be of one quantity", listed(quantities), APART)
    for one in functions:
        alike = one.frequency.shape == f.shape and np.allclose(one.frequency, f, rtol=1e-5)
        must = f"have the {f.size} lines to {f[-1]:g} Hz of {functions[0].source}"
        _must(alike, one.source, must, f"{one.frequency.size} to {one.frequency[-1]:g} Hz", APART)
    responses, references = (list(dict.fromkeys(labels)) for labels in zip(*places, strict=True))
    grid = list(product(responses, references))
    for pair, n in [(pair, places.count(pair)) for pair in grid]:
        _must(n == 1, "Functions", f"have each pair once, {' / '.join(pair)}", f"it {n} times", APART)
    order, shape = [places.index(pair) for pair in grid], (len(responses), len(references), f.size)
    values = np.reshape([kinds[k][2] * functions[k].values for k in order], shape)
    data = dataset(values, (references, responses), f, kinds[0][1::-1])
    gammas = [np.broadcast_to(functions[k].coherence, f.shape) for k in order]
    if not np.isnan(gammas).all():
        data["coherence"] = data["frequency_response"].dims, np.reshape(gammas, shape)
    return data
