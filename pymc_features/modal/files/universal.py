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
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pymc_features._checks import listed
from pymc_features.io.formats.libraries import AXES, FUNCTIONS, KNOWN, NAME, is_mark
from pymc_features.io.reading.lines import Lines, check_size, to_count, to_number, warn_of_widths
from pymc_features.modal.data import warn_modes
from pymc_features.modal.files.quantities import Identified

MODES = {2: "normal", 3: "complex", 7: "complex"}  # types of analysis
MOTION = {0: "unknown", 1: "general", 8: "displacement", 11: "velocity", 12: "acceleration"}
REAL, COMPLEX = 2, 5  # types of values
DIRECTIONS = {1: ("",), 3: AXES[:3], 6: AXES}  # by the values of a node
PER_LINE = 6  # values
_WHOLE = re.compile(r"[-+]?\d{1,12}", re.ASCII)


class Mode(NamedTuple):
    """A mode as a data set states it."""

    frequency: float  # [Hz]
    damping: float  # fraction of critical
    nodes: np.ndarray  # (node,)
    values: np.ndarray  # (node, direction)
    eigenvalue: complex  # [rad/s], NaN of normal modes
    rows: list[tuple[int, str]]  # numbers and texts of the lines with as many values as there are


def read_universal(path: Path) -> Identified:
    """All modes of a file, their channels named by node and direction."""
    if b"\0" in path.read_bytes():
        raise ValueError(
            f"{path.name} must hold text, it holds binary data sets (58b). Export the modes alone, as data "
            "set 55."
        )
    lines, modes, others = Lines(path, NAME), [], []
    while lines.peek() is not None:
        while not lines.take("a data set").strip():
            pass
        if not is_mark(lines.last):
            raise lines.error("a data set must begin with -1")
        kind = lines.take("the number of a data set")[:6].strip()
        if to_count(kind) is None:
            raise lines.error("the number of a data set must be there")
        found = READERS[kind](lines) if kind in READERS else ""
        if isinstance(found, Mode):
            modes.append(found)
            continue
        others.append(f"{kind} ({found})" if found else kind)
        while not is_mark(lines.take("-1 at the end of the data set")):
            pass
    if not modes:
        raise _no_modes(path, others)
    warn_of_widths(lines.title, [*(row for mode in modes for row in mode.rows), (0, "")])
    odd = [kind for kind in dict.fromkeys(others) if "(" in kind or int(kind) not in KNOWN]
    if odd:
        warn_modes(
            f"{path.name}: the data sets {listed(odd)} are not read, beside {len(modes)} modes. Is a digit "
            "of a number lost?"
        )
    return _identified(path, _without_conjugates(modes))


def _no_modes(path: Path, others: list[str]) -> ValueError:
    held = listed(list(dict.fromkeys(others)))
    advice = "Export the identified modes as data set 55."
    if FUNCTIONS in others:
        advice = (
            "Data set 58 holds measured functions: identify the modes first, or read its time histories by "
            "`read_channels`."
        )
    return ValueError(
        f"{path.name} ({NAME}) must hold modes, in data sets 55 or 2414 of normal or complex modes, got the "
        f"data sets {held[:200]}. {advice}"
    )


# --- one data set -----------------------------------------------------------------------------------


def _read_55(lines: Lines) -> Mode | str:
    """A mode, or what the data set holds instead."""
    layout = _layout(lines)
    if isinstance(layout, str):
        return layout
    counts = _wholes(lines, None, "the number of the mode")
    reals = _reals(lines, 2)
    if len(counts) > 1 and 1 < counts[1] != reals.size:
        raise lines.error(
            f"the frequency must stand among {counts[1]} numbers, as the line above says", reals.size
        )
    return _mode(lines, layout, reals)


def _read_2414(lines: Lines) -> Mode | str:
    """A mode, or what the data set holds instead."""
    for _ in range(2):
        lines.take("label and name of the data set")
    [place] = _wholes(lines, 1, "where the data are")
    if place != 1:
        return "data on elements"
    layout = _layout(lines)
    if isinstance(layout, str):
        return layout
    for _ in range(2):
        lines.take("the number of the mode")
    normal = np.zeros(6)
    given = _reals(lines, 1)[:6]
    normal[: given.size] = given  # time, frequency, eigenvalue, modal mass, two kinds of damping
    eigenvalue = _reals(lines, 2)
    numbers = eigenvalue if MODES[layout[0]] == "complex" else normal[[1, 3, 4, 5]]
    return _mode(lines, layout, numbers)


READERS: dict[str, Callable] = {"55": _read_55, "2414": _read_2414}


def _layout(lines: Lines) -> tuple[int, int, int] | str:
    """Type of analysis, type of the values, and values per node; or what it is if these are no modes."""
    for _ in range(5):
        lines.take("five lines of text")
    _, analysis, _, quantity, values, count = _wholes(lines, 6, "what the data are")
    if analysis not in MODES:
        return f"analysis of type {analysis}, no modes"
    if quantity not in MOTION:
        return f"modes of data of type {quantity}, no motion"
    if values not in (REAL, COMPLEX):
        raise lines.error("values must be real (2) or complex (5)", f"type {values}", "Export them so.")
    if count not in DIRECTIONS:
        raise lines.error(
            "a node must have 1, 3 or 6 values", count, "Export translations, or these and rotations."
        )
    return analysis, values, count


def _mode(lines: Lines, layout, numbers: np.ndarray) -> Mode:
    """The mode whose frequency, or eigenvalue, was read, and the values of its nodes."""
    analysis, values, count = layout
    eigenvalue = complex(np.nan)
    if MODES[analysis] == "complex":
        eigenvalue = complex(numbers[0], numbers[1])
        if eigenvalue == 0.0:
            raise lines.error(
                "the eigenvalue must not be zero", eigenvalue, "Leave out modes of a rigid body."
            )
        frequency, damping = abs(eigenvalue) / (2.0 * np.pi), -eigenvalue.real / abs(eigenvalue)
    else:
        viscous, hysteretic = (float(numbers[k]) if numbers.size > k else 0.0 for k in (2, 3))
        frequency, damping = float(numbers[0]), viscous or 0.5 * hysteretic  # zeta = eta / 2 at resonance
    nodes, entries, rows = _nodes(lines, count * (2 if values == COMPLEX else 1))
    if values == COMPLEX:
        entries = entries[:, ::2] + 1j * entries[:, 1::2]
    return Mode(frequency, damping, nodes, entries, eigenvalue, rows)


def _nodes(lines: Lines, count: int) -> tuple[np.ndarray, np.ndarray, list]:
    """Numbers (node,) and values (node, count), down to the end of the data set, and the lines of values."""
    nodes, values, seen, rows = array("q"), array("d"), set(), []
    while not is_mark(lines.take("the number of a node, or -1 at the end of the data set")):
        if not lines.last.strip():
            raise lines.error("the number of a node must be there", "an empty line")
        words = lines.last.split()
        if len(words) != 1 or to_count(words[0]) is None:
            raise lines.error("the number of a node must stand alone")
        node = int(words[0])
        if node in seen:
            raise lines.error("nodes must be there once", f"{node} again", "Leave out one of them.")
        seen.add(node)
        nodes.append(node)
        left = count
        while left:
            found = _numbers(lines.take("the values of a node"))
            if len(found) != min(left, PER_LINE):
                what = f"the values of a node must be {min(left, PER_LINE)} finite numbers"
                raise lines.error(what, advice="Export it again.")
            values.extend(found)
            left -= len(found)
            if len(found) == min(count, PER_LINE):
                rows.append((lines.number, lines.last))
    return np.array(nodes, dtype=np.int64), np.array(values).reshape(-1, count), rows


def _reals(lines: Lines, least: int) -> np.ndarray:
    """The finite numbers of a line, at least so many."""
    numbers = _numbers(lines.take("the frequency"))
    if len(numbers) < least:
        what = f"the frequency must stand in a line of at least {least} finite numbers"
        raise lines.error(what, advice="Export it again.")
    return np.array(numbers)


def _numbers(line: str) -> list[float]:
    """Numbers between blanks, or else in columns of 13 characters, which may touch; none if one is spoilt."""
    for words in (line.split(), _cut(line, 13)):
        numbers = [to_number(word) for word in words]
        if None not in numbers:
            return numbers if np.isfinite(numbers).all() else []
    return []


def _wholes(lines: Lines, count: int | None, what: str) -> list[int]:
    """The whole numbers of a line, as many or any number, between blanks or in columns of 10 characters."""
    line = lines.take(what)
    for words in (line.split(), _cut(line, 10)):
        if words and len(words) == (count or len(words)) and all(_WHOLE.fullmatch(word) for word in words):
            return [int(word) for word in words]
    raise lines.error(f"{what} must be said by {count or 'some'} whole numbers", advice="Export it again.")


def _cut(line: str, width: int) -> list[str]:
    line = line.rstrip()
    return [line[start : start + width].strip() for start in range(0, len(line), width)]


# --- all modes --------------------------------------------------------------------------------------


def _without_conjugates(modes: list[Mode]) -> list[Mode]:
    """Modes without those whose eigenvalue is the conjugate, below the real axis, of another."""
    above = np.array([mode.eigenvalue for mode in modes if mode.eigenvalue.imag > 0.0])

    def is_conjugate(mode):
        away = np.abs(above - np.conj(mode.eigenvalue))
        return mode.eigenvalue.imag < 0.0 and bool((away <= 1e-4 * abs(mode.eigenvalue)).any())

    return [mode for mode in modes if not is_conjugate(mode)]


def _identified(path: Path, modes: list[Mode]) -> Identified:
    """All modes on all nodes, NaN where a mode has none; directions without any motion were not measured."""
    nodes = np.unique(np.concatenate([mode.nodes for mode in modes]))
    counts = {mode.values.shape[1] for mode in modes}
    if len(counts) > 1:
        raise ValueError(
            f"{path.name} ({NAME}) must have the same number of values at each node in all modes, got "
            f"{listed(sorted(counts))}. Export them alike."
        )
    directions = DIRECTIONS[counts.pop()]
    kind = np.complex128 if any(mode.values.dtype.kind == "c" for mode in modes) else np.float64
    check_size(path, [16 * len(modes) * nodes.size * len(directions)])
    shapes = np.full((len(modes), nodes.size, len(directions)), np.nan, dtype=kind)
    for number, mode in enumerate(modes):
        shapes[number, np.searchsorted(nodes, mode.nodes)] = mode.values
    moving = ((shapes != 0.0) & ~np.isnan(shapes)).any(axis=0)  # a node may be missing in a mode
    if not moving.any():
        raise ValueError(
            f"{path.name} ({NAME}) must hold shapes that are not zero, got zeros. Export it again."
        )
    damping = np.array([mode.damping for mode in modes])
    return Identified(
        path.name,
        np.array([mode.frequency for mode in modes]),
        damping=np.where(damping == 0.0, np.nan, damping) if damping.any() else None,
        shapes=shapes[:, moving],
        channels=[f"{nodes[row]}{directions[column]}" for row, column in np.argwhere(moving)],
    )
