"""Places of the degrees of freedom, and shapes of modes there, for drawings."""

import csv
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features.exceptions import ConfigError
from pymc_features.update.config.keys import shown
from pymc_features.update.kinds.base import modes_of_draws, thinned

AXES = ("x", "y", "z")
COLUMNS = ("dof", "name", *AXES, "direction", "line")
SHAPES, MODES = 100, 10  # draws, and modes at least
MOST_POINTS = 1000


class Points(NamedTuple):
    """What is drawn of a shape."""

    dofs: np.ndarray  # (p,) degree of freedom of each point, -1 of one that is held
    nodes: dict | None  # as `plots.mode_shapes` takes it; None for the storeys of a chain

    def entries(self, shapes: np.ndarray) -> np.ndarray:
        """Take the points (..., p) of shapes (..., n_dof), zero where they are held."""
        return np.where(self.dofs < 0, 0.0, shapes[..., self.dofs])

    def of(self, dofs) -> list[int]:
        """The point of each of some degrees of freedom."""
        found = self.dofs.tolist()
        return [found.index(dof) for dof in dofs]


def points_of(problem) -> Points:
    """What is drawn of a mode shape: nodes of a file, or degrees of freedom along their numbers."""
    modal, n = problem.modal, problem.expected.n_dof
    if modal is not None and modal.nodes is not None:
        return modal.nodes
    kept = np.unique(np.linspace(0, n - 1, min(n, MOST_POINTS)).astype(int))
    return Points(np.union1d(kept, [*problem.first.dofs, *(modal.dofs if modal else [])]).astype(int), None)


def geometry(problem) -> xr.Dataset:
    """Places [m] of the points that are drawn, the directions in which they move, and lines between them."""
    points, modal = points_of(problem), problem.modal
    n, held = len(points.dofs), points.dofs.tolist()
    style = "storeys" if problem.structure.has_storeys else "entries"
    places, lines = np.outer(1.0 + points.dofs, [0.0, 0.0, 1.0]), [list(range(n))]
    directions = [[1.0, 0.0, 0.0]] * n
    if points.nodes is not None:
        style, lines = "nodes", points.nodes["lines"]
        places = np.array(points.nodes["coordinates"], dtype=float)
        spread = np.ptp(places, axis=0)  # along x where heights differ most, else along z
        default = [1.0, 0.0, 0.0] if spread[2] >= spread.max() > 0.0 else [0.0, 0.0, 1.0]
        directions = points.nodes.get("directions", [default] * n)
    sensors = {name: held.index(dof) for name, dof in problem.first.placed.items() if dof in held}
    attrs = {"style": style, "lines": json.dumps(lines), "sensors": json.dumps(sensors)}
    if modal is not None and len(modal.dofs):
        attrs["channels"] = json.dumps(points.of(modal.dofs))
    axes = ("point", "axis")
    columns = {"place": (axes, places), "direction": (axes, np.array(directions, dtype=float))}
    return xr.Dataset(columns, {"dof": ("point", points.dofs)}, attrs)


def mode_shapes(problem, posterior: xr.Dataset) -> xr.Dataset:
    """Mode shapes of the model at some draws, the first of which is the one nearest to the medians.

    `shape` (sample, mode, point) has a largest entry of 1 and the sign of the first sample; `frequency`
    (sample, mode) is in Hz.
    """
    points, draws = points_of(problem), posterior[problem.structure.names]
    wanted = max(problem.structure.n_modes or MODES, 0 if problem.modal is None else problem.modal.n_modes)
    away = (((draws - draws.median()) / draws.std()) ** 2).to_dataarray().sum("variable")
    nearest = {dim: [int(at)] for dim, at in away.argmin(["chain", "draw"]).items()}
    chosen = draws.isel(nearest), thinned(draws, SHAPES)
    found = [modes for few in chosen for _, modes in modes_of_draws(problem, few, wanted)]
    shapes = np.array([points.entries(one.mode_shapes.T[:wanted]) for one in found])
    largest = np.take_along_axis(shapes, np.abs(shapes).argmax(axis=-1)[..., None], axis=-1)
    shapes = shapes / np.where(largest == 0.0, 1.0, largest)
    shapes *= np.where((shapes * shapes[0]).sum(axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    values = np.array([one.natural_frequencies[:wanted] for one in found])
    return xr.Dataset(
        {
            "shape": (("sample", "mode", "point"), shapes.astype(np.float32)),
            "frequency": (("sample", "mode"), values, {"units": "Hz"}),
        },
        {"mode": 1 + np.arange(values.shape[1])},
    )


class Row(NamedTuple):
    """A point of a file."""

    dof: int
    place: tuple[float, float, float]
    direction: tuple[float, float, float] | None


def read_nodes(path: Path, channels: dict[str, int], n_dof: int) -> Points:
    """Read the nodes of a structure; `channels` are names to degrees of freedom, of which there are `n_dof`.

    The file is a CSV with the columns `dof`, from 0, or `name`, of a channel; `x`, `y`, `z` [m], zero where a
    column is missing; `direction`, x, y or z, perhaps with a minus, in which the degree of freedom moves; and
    `line`: rows that are equal there are joined in their order. Without a degree of freedom a node is held.
    What is wrong is a ConfigError that names the line.
    """
    if not path.is_file():
        raise ConfigError(f"`modal.nodes` must be an existing file, got {path}. Leave it out for storeys.")
    points, lines = {}, {}
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.DictReader(file)
            header = table.fieldnames = [name.strip() for name in table.fieldnames or []]
            check_header(path, header)
            for cells in table:
                cells = {name: (cell or "").strip() for name, cell in cells.items() if isinstance(name, str)}
                row = row_of(cells, f"{path.name}, line {table.line_num}", channels, n_dof)
                number = points.setdefault(row, len(points))
                lines.setdefault(cells.get("line", ""), []).append(number)
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"`modal.nodes` must be a CSV file, got {path.name}: {error}.") from error
    dofs = [row.dof for row in points]
    for name, dof in channels.items():
        if dof not in dofs:
            raise ConfigError(
                f"`modal.nodes` must have a row for every channel, {path.name} has none for {name} (degree "
                f"of freedom {dof}). Add it."
            )
    nodes = {"coordinates": [row.place for row in points], "lines": list(lines.values())}
    if "direction" in header:
        nodes["directions"] = [row.direction for row in points]
    return Points(np.array(dofs), nodes)


def check_header(path, header) -> None:
    """Known columns, each once, and those that are needed."""
    unknown = set(header) - set(COLUMNS)
    if unknown or len(set(header)) < len(header) or len({"dof", "name"} & set(header)) != 1:
        raise ConfigError(
            f"`modal.nodes` must have the columns dof or name, x, y, z, and perhaps direction and line, got "
            f"{shown(', '.join(header))} in {path.name}."
        )
    if not set(AXES) & set(header):
        raise ConfigError(f"`modal.nodes` must have a column x, y or z, got none in {path.name}.")


def row_of(cells, where, channels, n_dof) -> Row:
    """One line of a file: its degree of freedom, -1 where it is held, place [m] and direction."""

    def refuse(key, wanted, advice=""):
        text = f"`modal.nodes`, {where}: `{key}` must be {wanted}, got {shown(cells[key])}. {advice}"
        raise ConfigError(text.strip())

    name, text = cells.get("name", ""), cells.get("dof", "")
    if name and name not in channels:
        refuse("name", f"one of the channels {', '.join(channels)}", "Use a column `dof` for others.")
    if text and not (text.isdecimal() and len(text) < 10 and int(text) < n_dof):
        refuse("dof", f"a whole number from 0 to {n_dof - 1}, or empty where a node is held")
    dof, place = channels[name] if name else int(text or -1), []
    for axis in AXES:
        try:
            place.append(float(cells.get(axis, "0")))
        except ValueError:
            place.append(np.nan)
        if not np.isfinite(place[-1]):
            refuse(axis, "a number in m")
    if "direction" not in cells:
        return Row(dof, tuple(place), None)
    axis = cells["direction"].lstrip("+-")
    sign = -1.0 if cells["direction"].startswith("-") else 1.0
    if axis not in AXES and not (axis == "" and dof < 0):
        refuse("direction", "x, y, z or -x, -y, -z")
    return Row(dof, tuple(place), tuple(sign * (name == axis) for name in AXES))
