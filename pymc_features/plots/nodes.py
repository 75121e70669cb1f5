"""A structure in space, seen in a plane: its nodes, the lines between them, and how they move."""

from typing import NamedTuple

import numpy as np

from pymc_features._checks import as_list, as_numbers, check_mapping, message, shown

KEYS = ("coordinates", "directions", "lines")
DEPTH = 0.45  # of the second axis, drawn obliquely
OBLIQUE = np.array([[1.0, 0.0], [DEPTH * np.cos(0.6), DEPTH * np.sin(0.6)], [0.0, 1.0]])
ROOM = 1.3  # beyond the largest measured entry
AMPLITUDE = 0.15  # of the largest entry, over the extent of the structure


class Nodes(NamedTuple):
    """Points of a structure in the plane of the figure."""

    places: np.ndarray  # (k, 2) of the nodes; several entries of a shape may belong to one
    node: np.ndarray  # (p,) of each entry
    directions: np.ndarray  # (p, 2) in which an entry moves its node, zero where it is held; 1 in space
    lines: list[np.ndarray]  # nodes that are joined
    labels: tuple[str, str]  # of the axes of the figure

    @property
    def extent(self) -> float:
        """Length that amplitudes are a share of."""
        return float(np.ptp(self.places, axis=0).max()) or 1.0

    @property
    def bounds(self) -> np.ndarray:
        """Corners (2, 2) of what nodes reach."""
        reach = ROOM * AMPLITUDE * self.extent * np.abs(self.directions).max(axis=0)
        margin = np.maximum(reach, 0.04 * self.extent)
        return np.array([self.places.min(axis=0) - margin, self.places.max(axis=0) + margin])

    def moved(self, shape: np.ndarray) -> np.ndarray:
        """Places (..., k, 2) under a shape (..., p) with entries of at most about 1; NaN does not move."""
        steps = AMPLITUDE * self.extent * np.nan_to_num(shape)[..., None] * self.directions
        found = np.broadcast_to(self.places, (*shape.shape[:-1], *self.places.shape)).copy()
        for entry, node in enumerate(self.node):
            found[..., node, :] += steps[..., entry, :]
        return found


def checked_nodes(nodes, p: int) -> Nodes:
    """Nodes in the plane in which they lie and move, or obliquely from in front."""
    what = f"a mapping of {', '.join(KEYS)}"
    given = check_mapping(nodes, "nodes", what)
    if not {"coordinates"} <= set(given) <= set(KEYS):
        raise ValueError(message("nodes", what, ", ".join(given) or "nothing"))
    points = rows_of(given["coordinates"], "coordinates", p)
    directions = given.get("directions")
    if directions is None:
        rises = np.ptp(points[:, 2]) >= max(np.ptp(points[:, 0]), np.ptp(points[:, 1]))
        directions = np.tile([1.0, 0.0, 0.0] if rises else [0.0, 0.0, 1.0], (p, 1))
    directions = rows_of(directions, "directions", p)
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions / np.where(length > 0.0, length, 1.0)
    places, node = np.unique(points, axis=0, return_inverse=True)
    lines = [range(p)] if given.get("lines") is None else given["lines"]
    lines = [node[line] for line in checked_lines(lines, p)]
    projection, labels = plane_of(points, directions)
    return Nodes(places @ projection, node, directions @ projection, lines, labels)


def rows_of(values, name: str, p: int) -> np.ndarray:
    """Vectors (p, 3) in space; of two columns the third is zero."""
    array = as_numbers(values, "nodes", f"Give {name} in metres.")
    if array.shape not in ((p, 2), (p, 3)) or not np.isfinite(array).all():
        condition = f"with {p} rows of 2 or 3 finite {name}, one for each column of `shapes`"
        raise ValueError(message("nodes", condition, array.shape))
    return np.pad(array, ((0, 0), (0, 3 - array.shape[1])))


def checked_lines(lines, p: int) -> list[list[int]]:
    """Rows that are joined."""
    found = [as_list(line) for line in lines] if isinstance(lines, list | tuple) else [None]
    for row in (row for line in found for row in (line or ([None] if line is None else []))):
        is_whole = isinstance(row, int | np.integer) and not isinstance(row, bool)
        if not is_whole or not 0 <= row < p:
            condition = f"with lines that are lists of rows from 0 to {p - 1}"
            raise ValueError(message("nodes", condition, shown(lines)))
    return found


def plane_of(points: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, tuple[str, str]]:
    """A projection (3, 2) and the labels of its axes."""
    used = [k for k in range(3) if np.ptp(points[:, k]) > 0.0 or directions[:, k].any()]
    if len(used) > 2:
        return OBLIQUE, ("x [m]", "z [m]")
    for missing in (2, 0, 1):
        if len(used) < 2 and missing not in used:
            used = sorted([*used, missing])
    return np.eye(3)[:, used], tuple(f"{'xyz'[k]} [m]" for k in used)
