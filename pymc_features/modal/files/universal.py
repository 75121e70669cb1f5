"""Modes in Universal Files: data sets 55, data at nodes, and 2414, analysis data.

A data set stands between two lines of -1 in columns 5 and 6, its number below the first. Above the values of
each node are its number, and numbers in columns of 10 and 13 characters say what they are. Nodes whose values
are all zero may be left out, and directions that were not measured are zero (notes 9 and 15 to data set 55).

pyuff is not used here: it takes any -1 at the end of a line for the end of a data set, drops one that is cut,
and reads data sets 55 of three or six values at a node only.

Structural Dynamics Research Corporation, Universal File Datasets 55 and 2414; printed by the Structural
Dynamics Research Laboratory, University of Cincinnati.
"""

import re
from array import array
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pymc_features._checks import listed, require
from pymc_features.io.formats.libraries import AXES, FUNCTIONS, KNOWN, NAME, is_mark
from pymc_features.io.reading.lines import Lines, check_size, to_count, to_number, warn_of_widths
from pymc_features.modal.data import demand, warn_modes

NORMAL, COMPLEX_MODES = (2,), (3, 7)  # types of analysis
MOTION = 0, 1, 8, 11, 12  # unknown, general, displacement, velocity, acceleration
REAL, COMPLEX = 2, 5  # types of values
DIRECTIONS = {1: ("",), 3: AXES[:3], 6: AXES}  # by the values of a node
PER_LINE = 6  # values
_WHOLE = re.compile(r"[-+]?\d{1,12}", re.ASCII)


class Mode(NamedTuple):
    """A mode as a data set states it."""

    frequency: float  # [Hz]
    damping: float  # fraction of critical
    eigenvalue: complex  # [rad/s], NaN of normal modes
    nodes: np.ndarray  # (node,)
    values: np.ndarray  # (node, direction)
    rows: list[tuple[int, str]]  # numbers and texts of the lines with as many values as there are


def read_universal(path: Path) -> dict:
    """All modes of a file, their channels named by node and direction."""
    what = "it holds binary data sets (58b). Export the modes alone, as data set 55."
    require(b"\0" not in path.read_bytes(), f"{path.name} must hold text, {what}")
    lines, modes, others = Lines(path, NAME), [], []
    while lines.peek() is not None:
        while not lines.take("a data set").strip():
            pass
        lines.require(is_mark(lines.last), "a data set must begin with -1")
        kind = lines.take("the number of a data set")[:6].strip()
        lines.require(to_count(kind) is not None, "the number of a data set must be there")
        found = _read_mode(lines, kind) if kind in ("55", "2414") else ""
        if isinstance(found, Mode):
            modes.append(found)
            continue
        others.append(f"{kind} ({found})" if found else kind)
        while not is_mark(lines.take("-1 at the end of the data set")):
            pass
    advice = "Export the identified modes as data set 55."
    if FUNCTIONS in others:
        advice = "Data set 58 holds measured functions: identify the modes first, or read its time histories"
        advice = f"{advice} by `read_channels`."
    what = f"{path.name} ({NAME}) must hold modes, in data sets 55 or 2414 of normal or complex modes"
    demand(modes, what, f"the data sets {listed(list(dict.fromkeys(others)))[:200]}", advice)
    warn_of_widths(lines.title, [*(row for mode in modes for row in mode.rows), (0, "")])
    odd = [kind for kind in dict.fromkeys(others) if "(" in kind or int(kind) not in KNOWN]
    if odd:
        warn_modes(
            f"{path.name}: the data sets {listed(odd)} are not read, beside {len(modes)} modes. Is a digit "
            "of a number lost?"
        )
    return _joined(path, modes)


# --- one data set -----------------------------------------------------------------------------------


def _read_mode(lines: Lines, kind: str) -> Mode | str:
    """A mode, or what the data set holds instead."""
    if kind == "2414":
        lines.several(2, "lines with label and name of the data set")
        if _wholes(lines, 1, "where the data are") != [1]:
            return "data on elements"
    lines.several(5, "lines of text")
    _, analysis, _, quantity, values, count = _wholes(lines, 6, "what the data are")
    if analysis not in NORMAL + COMPLEX_MODES:
        return f"analysis of type {analysis}, no modes"
    if quantity not in MOTION:
        return f"modes of data of type {quantity}, no motion"
    are_known, got = values in (REAL, COMPLEX), f"type {values}"
    lines.require(are_known, "values must be real (2) or complex (5)", got, "Export them so.")
    advice = "Export translations, or these and rotations."
    lines.require(count in DIRECTIONS, "a node must have 1, 3 or 6 values", count, advice)
    if kind == "55":
        counts, reals = _wholes(lines, None, "the number of the mode"), _reals(lines, 2)
        announced = counts[1] if len(counts) > 1 and counts[1] > 1 else len(reals)
        what = f"the frequency must stand among {announced} numbers, as the line above says"
        lines.require(announced == len(reals), what, len(reals))
    else:
        lines.several(2, "lines with the number of the mode")
        # time, frequency, eigenvalue, modal mass, two kinds of damping
        normal, reals = [*_reals(lines, 1), *[0.0] * 5], _reals(lines, 2)
        reals = [normal[1], *normal[3:6]] if analysis in NORMAL else reals
    eigenvalue = complex(np.nan) if analysis in NORMAL else complex(*reals[:2])
    advice = "Leave out modes of a rigid body."
    lines.require(eigenvalue != 0.0, "the eigenvalue must not be zero", eigenvalue, advice)
    frequency, _, viscous, hysteretic = [*reals, 0.0, 0.0, 0.0][:4]
    damping = viscous or 0.5 * hysteretic  # zeta = eta / 2 at resonance
    if analysis in COMPLEX_MODES:
        frequency, damping = abs(eigenvalue) / (2.0 * np.pi), -eigenvalue.real / abs(eigenvalue)
    nodes, entries, rows = {}, array("d"), []
    count *= 2 if values == COMPLEX else 1
    while not is_mark(lines.take("the number of a node, or -1 at the end of the data set")):
        lines.require(lines.last.strip(), "the number of a node must be there", "an empty line")
        node = to_count(lines.last.strip())
        lines.require(node is not None, "the number of a node must stand alone")
        lines.require(
            node not in nodes, "nodes must be there once", f"{node} again", "Leave out one of them."
        )
        nodes[node] = None
        for left in range(count, 0, -PER_LINE):
            wanted = min(left, PER_LINE)
            found = _fields(lines.take("the values of a node"), 13, _finite)
            what = f"the values of a node must be {wanted} finite numbers"
            lines.require(len(found) == wanted, what, advice="Export it again.")
            entries.extend(found)
            if wanted == min(count, PER_LINE):
                rows.append((lines.number, lines.last))
    entries = np.array(entries).reshape(-1, count)
    if values == COMPLEX:
        entries = entries[:, ::2] + 1j * entries[:, 1::2]
    return Mode(frequency, damping, eigenvalue, np.array([*nodes], dtype=np.int64), entries, rows)


def _fields(line: str, width: int, parse) -> list:
    """What stands between blanks, or else in columns, which may touch; none if a part of it is spoilt."""
    line = line.rstrip()
    for words in (line.split(), [line[k : k + width].strip() for k in range(0, len(line), width)]):
        found = [parse(word) for word in words]
        if None not in found:
            return found
    return []


def _finite(word: str) -> float | None:
    return number if (number := to_number(word)) is not None and -np.inf < number < np.inf else None


def _reals(lines: Lines, least: int) -> list[float]:
    """The finite numbers of a line, at least so many."""
    numbers = _fields(lines.take("the frequency"), 13, _finite)
    what = f"the frequency must stand in a line of at least {least} finite numbers"
    lines.require(len(numbers) >= least, what, advice="Export it again.")
    return numbers


def _wholes(lines: Lines, count: int | None, what: str) -> list[int]:
    """The whole numbers of a line, as many or any number, between blanks or in columns of 10 characters."""
    numbers = _fields(lines.take(what), 10, lambda word: int(word) if _WHOLE.fullmatch(word) else None)
    how = f"{what} must be said by {count or 'some'} whole numbers"
    lines.require(numbers and len(numbers) == (count or len(numbers)), how, advice="Export it again.")
    return numbers


# --- all modes --------------------------------------------------------------------------------------


def _joined(path: Path, modes: list[Mode]) -> dict:
    """All modes on all nodes, NaN where a mode has none; directions without any motion were not measured.

    Those whose eigenvalue is the conjugate, below the real axis, of another are left out.
    """
    poles = np.array([mode.eigenvalue for mode in modes])
    pairs = abs(poles[poles.imag > 0.0][:, None] - poles.conj()) <= 1e-4 * abs(poles)
    doubled = (poles.imag < 0.0) & pairs.any(axis=0)
    modes = [mode for mode, again in zip(modes, doubled, strict=True) if not again]
    nodes = np.unique(np.concatenate([mode.nodes for mode in modes]))
    counts = {mode.values.shape[1] for mode in modes}
    what = f"{path.name} ({NAME}) must have the same number of values at each node in all modes"
    demand(len(counts) == 1, what, listed(sorted(counts)), "Export them alike.")
    directions = DIRECTIONS[counts.pop()]
    kind = np.result_type(np.float64, *(mode.values.dtype for mode in modes))
    check_size(path, [16 * len(modes) * nodes.size * len(directions)])
    shapes = np.full((len(modes), nodes.size, len(directions)), np.nan, dtype=kind)
    for number, mode in enumerate(modes):
        shapes[number, np.searchsorted(nodes, mode.nodes)] = mode.values
    moving = np.nan_to_num(shapes).any(axis=0)  # a node may be missing in a mode
    what = f"{path.name} ({NAME}) must hold shapes that are not zero"
    demand(moving.any(), what, "zeros", "Export it again.")
    damping = np.array([mode.damping for mode in modes])
    return {
        "frequencies": np.array([mode.frequency for mode in modes]),
        "damping_ratios": np.where(damping == 0.0, np.nan, damping) if damping.any() else None,
        "shapes": shapes[:, moving],
        "channels": [f"{nodes[row]}{directions[column]}" for row, column in np.argwhere(moving)],
    }
