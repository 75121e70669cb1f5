"""Places of the degrees of freedom, for drawings of mode shapes."""

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pymc_features.exceptions import ConfigError
from pymc_features.update.config.messages import shown

AXES = {"x": 0, "y": 1, "z": 2}
COLUMNS = ("dof", "name", *AXES, "direction", "line")


class Points(NamedTuple):
    """What is drawn of a shape.

    Attributes
    ----------
    dofs : array (p,)
        Degree of freedom of each point, -1 of one that is held.
    nodes : dict or None
        As `plot_mode_shapes` takes it; None for the storeys of a chain.
    """

    dofs: np.ndarray
    nodes: dict | None

    def entries(self, shapes: np.ndarray) -> np.ndarray:
        """Take the points (..., p) of shapes (..., n_dof), zero where they are held."""
        return np.where(self.dofs < 0, 0.0, shapes[..., self.dofs])

    def of(self, dofs) -> list[int]:
        """The point of each of some degrees of freedom."""
        found = self.dofs.tolist()
        return [found.index(dof) for dof in dofs]


class Row(NamedTuple):
    """A point of the file."""

    dof: int
    place: tuple[float, float, float]
    direction: tuple[float, float, float] | None
    line: str


def read_nodes(path: Path, channels: dict[str, int], n_dof: int) -> Points:
    """Read the nodes of a structure.

    Parameters
    ----------
    path : Path
        A CSV with the columns `dof`, from 0, or `name`, of a channel; `x`, `y`, `z` [m], zero where a column
        is missing; `direction`, x, y or z, perhaps with a minus, in which the degree of freedom moves; and
        `line`: rows that are equal there are joined in their order. Without a degree of freedom a node is
        held.
    channels : dict
        Names to degrees of freedom.
    n_dof : int

    Raises
    ------
    ConfigError
        If it is not as described, or a channel is not in it; the message names the line.
    """
    if not path.is_file():
        raise ConfigError(f"`modal.nodes` must be an existing file, got {path}. Leave it out for storeys.")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.DictReader(file)
            header = [name.strip() for name in table.fieldnames or []]
            check_header(path, header)
            table.fieldnames = header
            rows = [row_of(cells, f"{path.name}, line {table.line_num}", channels, n_dof) for cells in table]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"`modal.nodes` must be a CSV file, got {path.name}: {error}.") from error
    missing = [name for name, dof in channels.items() if dof not in {row.dof for row in rows}]
    if missing:
        raise ConfigError(
            f"`modal.nodes` must have a row for every channel, {path.name} has none for {missing[0]} (degree "
            f"of freedom {channels[missing[0]]}). Add it."
        )
    points = list(dict.fromkeys((row.dof, row.place, row.direction) for row in rows))
    lines: dict[str, list[int]] = {}
    for row in rows:
        lines.setdefault(row.line, []).append(points.index((row.dof, row.place, row.direction)))
    nodes = {"coordinates": [place for _, place, _ in points], "lines": list(lines.values())}
    if "direction" in header:
        nodes["directions"] = [direction for _, _, direction in points]
    return Points(np.array([dof for dof, _, _ in points]), nodes)


def check_header(path, header) -> None:
    """Known columns, each once, and those that are needed."""
    unknown = [name for name in header if name not in COLUMNS]
    if unknown or len(set(header)) < len(header) or len({"dof", "name"} & set(header)) != 1:
        raise ConfigError(
            f"`modal.nodes` must have the columns dof or name, x, y, z, and perhaps direction and line, got "
            f"{shown(', '.join(header))} in {path.name}."
        )
    if not set(AXES) & set(header):
        raise ConfigError(f"`modal.nodes` must have a column x, y or z, got none in {path.name}.")


def row_of(cells, where, channels, n_dof) -> Row:
    """One line of the file."""
    cells = {name: (cell or "").strip() for name, cell in cells.items() if isinstance(name, str)}
    dof = dof_of(cells, where, channels, n_dof)
    place = [number_of(cells.get(axis, "0"), axis, where) for axis in AXES]
    return Row(dof, tuple(place), direction_of(cells, where, dof), cells.get("line", ""))


def dof_of(cells, where, channels, n_dof) -> int:
    """A degree of freedom, -1 without one."""
    if "name" in cells:
        if cells["name"] and cells["name"] not in channels:
            raise ConfigError(
                f"`modal.nodes`, {where}: `name` must be one of the channels {', '.join(channels)}, got "
                f"{shown(cells['name'])}. Use a column `dof` for others."
            )
        return channels.get(cells["name"], -1)
    text = cells["dof"]
    if not text:
        return -1
    if not (text.isdecimal() and len(text) < 10 and int(text) < n_dof):
        raise ConfigError(
            f"`modal.nodes`, {where}: `dof` must be a whole number from 0 to {n_dof - 1}, or empty where a "
            f"node is held, got {shown(text)}."
        )
    return int(text)


def number_of(text, axis, where) -> float:
    """A coordinate [m]."""
    try:
        number = float(text)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise ConfigError(f"`modal.nodes`, {where}: `{axis}` must be a number in m, got {shown(text)}.")
    return number


def direction_of(cells, where, dof):
    """A unit vector; zero where the node is held."""
    if "direction" not in cells:
        return None
    text = cells["direction"]
    sign, axis = (-1.0, text[1:]) if text.startswith("-") else (1.0, text.removeprefix("+"))
    if dof < 0 and not text:
        return (0.0, 0.0, 0.0)
    if axis not in AXES:
        raise ConfigError(
            f"`modal.nodes`, {where}: `direction` must be x, y, z or -x, -y, -z, got {shown(text)}."
        )
    return tuple(sign * (k == AXES[axis]) for k in range(3))
