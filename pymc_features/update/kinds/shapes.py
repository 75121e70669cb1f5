"""Places of the degrees of freedom, and shapes of modes there, for drawings."""

import json
from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features.update.kinds.base import modes_of_draws, thinned

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
    n, drawn = len(points.dofs), points.dofs.tolist()
    style = "storeys" if problem.structure.has_storeys else "entries"
    places, lines = np.outer(1.0 + points.dofs, [0.0, 0.0, 1.0]), [list(range(n))]
    directions = [[1.0, 0.0, 0.0]] * n
    if points.nodes is not None:
        style, lines = "nodes", points.nodes["lines"]
        places = np.array(points.nodes["coordinates"], dtype=float)
        spread = np.ptp(places, axis=0)  # along x where heights differ most, else along z
        default = [1.0, 0.0, 0.0] if spread[2] >= spread.max() > 0.0 else [0.0, 0.0, 1.0]
        directions = points.nodes.get("directions", [default] * n)
    sensors = {name: drawn.index(dof) for name, dof in problem.first.placed.items() if dof in drawn}
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
