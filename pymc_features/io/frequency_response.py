"""Frequency response functions from files of analysers and modal programs, as one array with its labels.

Parts of complex numbers, decibels, degrees, units and places are what a file states; arguments say what it
leaves open, and must not contradict it.
"""

import re
import warnings
from collections.abc import Sequence
from itertools import product
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pymc_features._checks import (
    as_list,
    check_file,
    check_text,
    check_texts,
    listed,
    message,
    require,
    shown,
    warn_caller,
)
from pymc_features.io.formats.libraries import AXES, FUNCTIONS, QUANTITY_OF_TYPE, UNIVERSAL
from pymc_features.io.formats.matlab import load_variables
from pymc_features.io.formats.text import read_columns
from pymc_features.io.reading.labels import SI, Label, role_of, unit_of
from pymc_features.io.reading.lines import Lines, by_library
from pymc_features.io.reading.recording import Request

if TYPE_CHECKING:
    import xarray as xr

FUNCTION, COHERENCE, FORCE = (4, 5), 6, 13  # types of functions, 5 transmissibility; of a denominator
WORDS = {"real": "real re", "imaginary": "imaginary imag im", "magnitude": "magnitude mag amplitude abs"}
WORDS |= {"phase": "phase angle", "coherence": "coherence coh"}
PARTS = {word: part for part, words in WORDS.items() for word in words.split()}
ANGLES = {"deg": np.pi / 180.0, "°": np.pi / 180.0, "rad": 1.0}
#: Quantity of the response by the name of a function.
NAMES = {"accelerance": "acceleration", "inertance": "acceleration", "mobility": "velocity"}
NAMES |= {"receptance": "displacement", "compliance": "displacement"}
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
    coherence: np.ndarray | None = None


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
        Node and direction, "5:+z", or name of a channel: one for all, one for each function in their order,
        or for each row and column of an array. Labels of columns, "5:+z/3:+z real", and names of files,
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
        If a file is broken, or contradicts others or an argument, a pair is there twice or missing, something
        needed is said nowhere, or pyuff is not installed; the message names it.

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
    units = None if units is None else check_text(units, "units", 'Pass a ratio such as "(m/s^2)/N".')
    paths = [files] if isinstance(files, str | PathLike) else as_list(files) or []
    functions = [function for path in paths for function in _read(check_file(path, "files"), columns)]
    _must(functions, "`files`", "be a path, or several", shown(files), "Name files.")
    for source, f, values, *_ in functions:
        rises = values.shape == f.shape and f.size > 1 and (np.diff(f) > 0.0).all()
        _must(rises, source, "have values at two or more rising frequencies", f"{values.size} at {f.size}")
        _must(np.isfinite(values).all(), source, "be finite", f"NaN at {f[~np.isfinite(values)][:1]} Hz")
        _must(np.imag(values).any(), source, "be complex", "real parts alone")
        steps = np.diff(f) / np.median(np.diff(f))
        is_even = (np.abs(steps - 1.0) < 0.01).mean() > 0.8
        if (missing := f[1:][(values[1:] == 0.0) | (is_even & (steps > 1.5))]).size:
            text = f"{source}: lines at or before {listed(missing, 5)} Hz are missing. Were they cut out?"
            warn_caller(text)
    return _dataset(functions, _labels(functions, response, reference), units)


def _must(holds, source: str, be: str, got, advice: str = "Export it again.") -> None:
    """Refuse what a file holds."""
    require(holds, f"{source} must {be}, got {got}. {advice}")


# --- files ------------------------------------------------------------------------------------------


def _read(path: Path, columns) -> list[Function]:
    """The functions of a file."""
    if re.match(UNIVERSAL, raw := path.read_bytes()):
        _must(raw.rstrip().endswith(b"    -1"), path.name, "end with a line of -1", "none")
        return _universal(path, raw)
    if path.suffix.lower() == ".npz":
        with by_library("NumPy", "", path, ".npz"), np.load(path, allow_pickle=False) as arrays:
            return _of_arrays(path, dict(arrays))
    is_array = path.suffix.lower() in (".mat", ".h5", ".hdf5")
    return _of_arrays(path, load_variables(path)) if is_array else _table(path, columns)


def _universal(path: Path, raw: bytes) -> list[Function]:
    """Functions of data sets 58, with the coherences that stand beside them."""
    with by_library("pyuff", "modal", path, "Universal"), warnings.catch_warnings():
        import pyuff

        warnings.simplefilter("ignore")
        file = pyuff.UFF(str(path))
        kinds = [str(int(kind)) for kind in file.get_set_types()]
        sets = [file.read_sets(k) for k, kind in enumerate(kinds) if kind == FUNCTIONS]
    functions, coherences = [], {}
    for one in [one for one in sets if one["func_type"] in (*FUNCTION, COHERENCE)]:
        places, n, values, x = (_place(one, "rsp"), _place(one, "ref")), one["num_pts"], one["data"], one["x"]
        source = f"{path.name}, {'/'.join(places)}"
        whole = n <= values.size < n + 3 and not values[n:].any()  # the last line may be filled with zeros
        if one["binary"]:  # numbers must reach to the end, else a byte was lost or added
            order, size = (
                "<" if one["byte_ordering"] == 1 else ">",
                4 if one["ord_data_type"] in (2, 5) else 8,
            )
            last = np.array(values[-1:]).view(np.float64)[-1:].astype(f"{order}f{size}").tobytes()
            whole = whole and any(last + end + b"    -1" in raw for end in (b"", b"\n", b"\r\n"))
        _must(whole, source, f"have the {n} lines of its header", values.size)
        if one["func_type"] == COHERENCE:
            coherences[places] = values[:n].real
            continue
        line = np.polyval(np.polyfit(np.arange(n), x[:n], 1), np.arange(n))
        rounded = not one["abscissa_spacing"] and np.abs(x[:n] - line).max() < 1e-5 * x[n - 1]  # six digits
        texts = [one[f"{axis}_axis_units_lab"].strip() for axis in ("abscissa", "ordinate", "orddenom")]
        hertz, over, under = (
            t.replace("\ufffd", "²") if t.lower() != "none" else "" for t in texts
        )  # Latin-1
        codes = [one[f"{axis}_spec_data_type"] for axis in ("ordinate", "orddenom")]
        says = tuple("force" if code == FORCE else QUANTITY_OF_TYPE.get(code) or "" for code in codes)
        units = f"({over})/({under})" if over and under else over
        f = (line if rounded else x[:n]) * _hertz(hertz, source)
        functions.append(Function(source, f, values[:n], units, places, says))
    types = listed([f"type {kind}" for kind in dict.fromkeys(one["func_type"] for one in sets)])
    must = "hold frequency response functions, data sets 58 of type 4"
    _must(functions, path.name, must, types, "Read time histories by `read_channels`.")
    return [one._replace(coherence=coherences.get(one.places)) for one in functions]


def _place(one: dict, end: str) -> str:
    """Node and direction of an end of a function, or the name of its channel; empty if there is neither."""
    node, direction, name = one[f"{end}_node"], one[f"{end}_dir"], one[f"{end}_ent_name"].strip()
    if node > 0 and 0 < abs(direction) <= len(AXES):
        return f"{node}:{'-' if direction < 0 else '+'}{AXES[abs(direction) - 1].lower()}"
    return name if name.lower() != "none" else ""


def _hertz(unit: str, source: str) -> float:
    """Hertz in the unit of frequencies, which is hertz where nothing is said."""
    hertz = unit_of(unit or "Hz")
    is_frequency = unit == "rad/s" or (hertz is not None and hertz.quantity == "frequency")
    _must(is_frequency, source, "have frequencies in Hz or rad/s", repr(unit))
    return 0.5 / np.pi if unit == "rad/s" else hertz.factor


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
        labels, values = (table := read_columns(path, Request())).labels, table.values
        units = next((line.split("\t")[1].strip() for line in lines[:60] if line.startswith("Hz\t")), "")
    said = listed([label.text for label in labels if label.text])
    texts = check_texts([] if columns is None else columns, "columns", "labels of columns")
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


# --- what they state --------------------------------------------------------------------------------


def _is_frequency(name: str) -> bool:
    """Whether a label is that of frequencies."""
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
        source, says = (
            f"{path.name}, {name}" if name else path.name,
            [NAMES[n] for n in NAMES if n in name.lower()],
        )
        stated, values = _complex(group, source)
        places = next((tuple(p) for p in (places_in(name), places_in(path.stem)) if len(p) == 2), ("", ""))
        gamma = group["coherence"][1].real if "coherence" in group else None
        for k in np.ndindex(values.shape[:-1]):
            one = Function(source, frequency, values[k], stated or units, places, tuple(says))
            functions.append(one if gamma is None else one._replace(coherence=gamma[k]))
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
    n, names, choices, places = len(functions), ("response", "reference"), [], []
    for name, labels in zip(names, (response, reference), strict=True):
        texts = check_texts([] if labels is None else labels, name, "places such as '5:+z'")
        choices.append([(places_in(text) or [text])[0] for text in texts] or [""])
    sizes = [len(labels) for labels in choices]
    fits, is_grid = {*sizes} <= {1, n}, sizes[0] * sizes[1] == n
    what = f"one place, or one for each of {n} functions"
    require(fits or is_grid, message("response, reference", what, sizes))
    pairs = product(*choices) if is_grid else zip(*(x * (n // len(x)) for x in choices), strict=True)
    for one, pair in zip(functions, pairs, strict=True):
        for name, stated, said in zip(names, one.places, pair, strict=True):
            alike, got = (stated or said) and said in ("", stated or said), f"{one.source} states {stated!r}"
            _must(alike, f"`{name}`", "be the place of the function, such as '5:+z'", f"{said!r}, {got}", "")
        places.append(tuple(stated or said for stated, said in zip(one.places, pair, strict=True)))
    return places


def _ratio(text: str) -> tuple[str, str, float] | None:
    """SI units of response and excitation of a ratio, and the factor to them; None where it is none."""
    for pattern, groups in RATIOS.items():
        if match := re.fullmatch(pattern, text):
            y, x = (unit_of(match[k]) for k in groups)
            if y and x and y.quantity in NAMES.values() and x.quantity in ("force", "acceleration"):
                return SI[y.quantity], SI[x.quantity], y.factor / x.factor
    return None


def _in_si(one: Function, units: str | None) -> tuple[str, str, float]:
    """SI units of response and excitation of a function, the factor to them, by the file or the argument."""
    stated, said = _ratio(one.units), _ratio(units or "")
    alike = (stated or said) and (units is None or said) and said in (None, stated or said)
    got = f"{shown(units)}, {one.source} states {one.units!r}"
    _must(alike, "`units`", 'be a ratio such as "(m/s^2)/N", and that of the file', got, "")
    if one.units and not stated:
        warn_caller(f"{one.source} states the units {one.units!r}; the argument units={units!r} is used.")
    ratio, says = stated or said, " per ".join(one.kinds)
    is_so = all(not kind or SI.get(kind) == unit for kind, unit in zip(one.kinds, ratio, strict=False))
    _must(is_so, one.source, f"be {says} as it says", f"units {one.units or units}", "Correct one of them.")
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
    gammas = [functions[k].coherence for k in order]
    if any(gamma is not None for gamma in gammas):
        gammas = [np.full(f.size, np.nan) if gamma is None else gamma for gamma in gammas]
        data["coherence"] = data["frequency_response"].dims, np.reshape(gammas, shape)
    return data
