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

from pymc_features._checks import listed
from pymc_features.io.formats.libraries import AXES, FUNCTIONS, KNOWN, NAME, is_mark
from pymc_features.io.reading.lines import Lines, check_size, to_count, to_number, warn_of_widths
from pymc_features.modal.data import refusal, warn_modes

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
    eigenvalue: complex  # [rad/s], NaN of normal modes
    nodes: np.ndarray  # (node,)
    values: np.ndarray  # (node, direction)
    rows: list[tuple[int, str]]  # numbers and texts of the lines with as many values as there are


def read_universal(path: Path) -> dict:
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
        advice = "Export the identified modes as data set 55."
        if FUNCTIONS in others:
            advice = (
                "Data set 58 holds measured functions: identify the modes first, or read its time histories"
            )
            advice = f"{advice} by `read_channels`."
        what = f"{path.name} ({NAME}) must hold modes, in data sets 55 or 2414 of normal or complex modes"
        raise refusal(what, f"the data sets {listed(list(dict.fromkeys(others)))[:200]}", advice)
    warn_of_widths(lines.title, [*(row for mode in modes for row in mode.rows), (0, "")])
    odd = [kind for kind in dict.fromkeys(others) if "(" in kind or int(kind) not in KNOWN]
    if odd:
        warn_modes(
            f"{path.name}: the data sets {listed(odd)} are not read, beside {len(modes)} modes. Is a digit "
            "of a number lost?"
        )
    return _joined(path, modes)


# --- one data set -----------------------------------------------------------------------------------


def _read_55(lines: Lines) -> Mode | str:
    """A mode, or what the data set holds instead."""
    layout = _layout(lines)
    if isinstance(layout, str):
        return layout
    counts = _wholes(lines, None, "the number of the mode")
    reals = _reals(lines, 2)
    if len(counts) > 1 and 1 < counts[1] != len(reals):
        what = f"the frequency must stand among {counts[1]} numbers, as the line above says"
        raise lines.error(what, len(reals))
    return _mode(lines, layout, reals)


def _read_2414(lines: Lines) -> Mode | str:
    """A mode, or what the data set holds instead."""
    for _ in range(2):
        lines.take("label and name of the data set")
    if _wholes(lines, 1, "where the data are") != [1]:
        return "data on elements"
    layout = _layout(lines)
    if isinstance(layout, str):
        return layout
    for _ in range(2):
        lines.take("the number of the mode")
    # time, frequency, eigenvalue, modal mass, two kinds of damping
    normal = [*_reals(lines, 1), *[0.0] * 5]
    eigenvalue = _reals(lines, 2)
    return _mode(lines, layout, eigenvalue if MODES[layout[0]] == "complex" else [normal[1], *normal[3:6]])


READERS = {"55": _read_55, "2414": _read_2414}


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
        advice = "Export translations, or these and rotations."
        raise lines.error("a node must have 1, 3 or 6 values", count, advice)
    return analysis, values, count


def _mode(lines: Lines, layout, numbers: list[float]) -> Mode:
    """The mode whose frequency, or eigenvalue, was read, and the values of its nodes."""
    analysis, values, count = layout
    eigenvalue = complex(np.nan)
    if MODES[analysis] == "complex":
        eigenvalue = complex(numbers[0], numbers[1])
        if eigenvalue == 0.0:
            what, advice = "the eigenvalue must not be zero", "Leave out modes of a rigid body."
            raise lines.error(what, eigenvalue, advice)
        frequency, damping = abs(eigenvalue) / (2.0 * np.pi), -eigenvalue.real / abs(eigenvalue)
    else:
        frequency, _, viscous, hysteretic = [*numbers, 0.0, 0.0, 0.0][:4]
        damping = viscous or 0.5 * hysteretic  # zeta = eta / 2 at resonance
    nodes, entries, rows = _nodes(lines, count * (2 if values == COMPLEX else 1))
    if values == COMPLEX:
        entries = entries[:, ::2] + 1j * entries[:, 1::2]
    return Mode(frequency, damping, eigenvalue, nodes, entries, rows)


def _nodes(lines: Lines, count: int) -> tuple[np.ndarray, np.ndarray, list]:
    """Numbers (node,) and values (node, count), down to the end of the data set, and the lines of values."""
    nodes, values, rows = {}, array("d"), []
    while not is_mark(lines.take("the number of a node, or -1 at the end of the data set")):
        if not lines.last.strip():
            raise lines.error("the number of a node must be there", "an empty line")
        node = to_count(lines.last.strip())
        if node is None:
            raise lines.error("the number of a node must stand alone")
        if node in nodes:
            raise lines.error("nodes must be there once", f"{node} again", "Leave out one of them.")
        nodes[node] = None
        for left in range(count, 0, -PER_LINE):
            found, wanted = _numbers(lines.take("the values of a node")), min(left, PER_LINE)
            if len(found) != wanted:
                what = f"the values of a node must be {wanted} finite numbers"
                raise lines.error(what, advice="Export it again.")
            values.extend(found)
            if wanted == min(count, PER_LINE):
                rows.append((lines.number, lines.last))
    return np.array([*nodes], dtype=np.int64), np.array(values).reshape(-1, count), rows


def _reals(lines: Lines, least: int) -> list[float]:
    """The finite numbers of a line, at least so many."""
    numbers = _numbers(lines.take("the frequency"))
    if len(numbers) < least:
        what = f"the frequency must stand in a line of at least {least} finite numbers"
        raise lines.error(what, advice="Export it again.")
    return numbers


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
    if len(counts) > 1:
        what = f"{path.name} ({NAME}) must have the same number of values at each node in all modes"
        raise refusal(what, listed(sorted(counts)), "Export them alike.")
    directions = DIRECTIONS[counts.pop()]
    kind = np.result_type(np.float64, *(mode.values.dtype for mode in modes))
    check_size(path, [16 * len(modes) * nodes.size * len(directions)])
    shapes = np.full((len(modes), nodes.size, len(directions)), np.nan, dtype=kind)
    for number, mode in enumerate(modes):
        shapes[number, np.searchsorted(nodes, mode.nodes)] = mode.values
    moving = np.nan_to_num(shapes).any(axis=0)  # a node may be missing in a mode
    if not moving.any():
        what = f"{path.name} ({NAME}) must hold shapes that are not zero"
        raise refusal(what, "zeros", "Export it again.")
    damping = np.array([mode.damping for mode in modes])
    return {
        "frequencies": np.array([mode.frequency for mode in modes]),
        "damping_ratios": np.where(damping == 0.0, np.nan, damping) if damping.any() else None,
        "shapes": shapes[:, moving],
        "channels": [f"{nodes[row]}{directions[column]}" for row, column in np.argwhere(moving)],
    }
