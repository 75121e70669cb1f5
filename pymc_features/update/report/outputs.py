"""What an update leaves behind: netCDF with all that its report needs, tables, figures, and the report."""

import json
from pathlib import Path

import numpy as np
import xarray as xr

from pymc_features.storage import netcdf_bytes, write_atomically
from pymc_features.update.kinds.structure import modes_of
from pymc_features.update.presentation.nodes import Points
from pymc_features.update.presentation.numbers import as_csv, as_latex
from pymc_features.update.problem import Problem
from pymc_features.update.report.document import document_of
from pymc_features.update.report.figures import figures
from pymc_features.update.report.findings import Findings, findings
from pymc_features.update.report.page import page_of
from pymc_features.update.report.summary import kinds_of

SHAPES, MODES = 24, 10  # draws and modes that are drawn
MOST_POINTS = 1000


def write_outputs(
    problem: Problem, result, folder, channel_warnings=(), found: Findings | None = None
) -> list[Path]:
    """Write `update.nc`, `table.csv`, `table.tex`, the figures and `report.html`; return their paths.

    The page is made from what is written to `update.nc` alone: `pymc-features report` makes it again.

    Parameters
    ----------
    problem : Problem
        What was updated.
    result : DataTree
        From `run_update`.
    folder : path
        Made if needed.
    channel_warnings : sequence of str
        What was said about the channels, and identified modes, when they were read.
    found : Findings, optional
        From `findings`, if it is at hand; else it is made here.

    Returns
    -------
    list of Path
        The report last.
    """
    folder = Path(folder)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    found = found or findings(problem, result)
    warnings = [*(f"data: {text}" for text in channel_warnings), *map(str, found.doubts)]
    saved = with_document(problem, result, found, warnings)
    writers = {
        "update.nc": lambda path: path.write_bytes(netcdf_bytes(saved)),
        "table.csv": lambda path: path.write_text(as_csv(found.table), encoding="utf-8"),
        "table.tex": lambda path: path.write_text(as_latex(found.table), encoding="utf-8"),
    }
    for figure in figures(problem, result):
        image = figure.png()
        writers[f"figures/{figure.name}.png"] = lambda path, image=image: path.write_bytes(image)
    writers["report.html"] = lambda path: path.write_text(page_of(saved), encoding="utf-8")
    for name, write in writers.items():
        write_atomically(folder / name, write)
    return [folder / name for name in writers]


def with_document(problem: Problem, result, found: Findings, warnings) -> xr.DataTree:
    """The result with the attribute `document` and with what figures need besides.

    Parameters
    ----------
    problem, result, found, warnings
        As of `document_of`.

    Returns
    -------
    DataTree
        Also what each kind of data draws, see `KindOfData.drawn`, and of a structure with modes `/geometry`,
        where its degrees of freedom are, and in each likelihood `mode_shapes`. The one given is as it was.
    """
    saved = result.copy()
    saved.attrs["document"] = json.dumps(document_of(problem, result, found, warnings))
    saved.attrs["units"] = json.dumps({name: problem.unit(name) for name in problem.priors})
    for kind in kinds_of(result):
        part = result[kind]
        groups = {name: one for data in problem.data for name, one in data.drawn_of(problem, part).items()}
        if problem.structure.has_modes:
            groups["mode_shapes"] = mode_shapes(problem, part["posterior"].to_dataset())
        for name, group in groups.items():
            saved[f"{kind}/{name}"] = xr.DataTree(group)
    shared = {name: one for data in problem.data for name, one in data.drawn(problem).items()}
    if problem.structure.has_modes:
        shared["geometry"] = geometry(problem)
    for name, group in shared.items():
        saved[name] = xr.DataTree(group)
    return saved


def points_of(problem) -> tuple[Points, str]:
    """What is drawn of a mode shape, and how: storeys, nodes of a file, or entries along their numbers."""
    modal, section = problem.modal, problem.structure
    expected = section(**{name: problem.priors[name].median for name in section.names})
    if modal is not None and modal.points is not None and modal.points.nodes is not None:
        return modal.points, "nodes"
    kept = np.unique(np.linspace(0, expected.n_dof - 1, min(expected.n_dof, MOST_POINTS)).astype(int))
    kept = np.union1d(kept, problem.dofs or (modal.dofs if modal is not None else [])).astype(int)
    return Points(kept, None), "storeys" if section.has_storeys else "entries"


def geometry(problem) -> xr.Dataset:
    """Places [m] of the points that are drawn, the directions in which they move, and lines between them."""
    points, style = points_of(problem)
    n = len(points.dofs)
    if points.nodes is None:
        places = np.zeros((n, 3))
        places[:, 2] = 1 + points.dofs
        directions, lines = np.tile([1.0, 0.0, 0.0], (n, 1)), [list(range(n))]
    else:
        places, lines = np.array(points.nodes["coordinates"], dtype=float), points.nodes["lines"]
        directions = np.array(points.nodes.get("directions", default_directions(places)), dtype=float)
    held = points.dofs.tolist()
    sensors = {name: held.index(dof) for name, dof in problem.first.placed.items() if dof in held}
    attrs = {"style": style, "lines": json.dumps(lines), "sensors": json.dumps(sensors)}
    if problem.modal is not None and len(problem.modal.dofs):
        attrs["channels"] = json.dumps(points.of(problem.modal.dofs))
    return xr.Dataset(
        {"place": (("point", "axis"), places), "direction": (("point", "axis"), directions)},
        {"dof": ("point", points.dofs)},
        attrs,
    )


def default_directions(places) -> np.ndarray:
    """Along x where heights differ most, else along z."""
    spread = np.ptp(places, axis=0)
    return np.tile([1.0, 0.0, 0.0] if spread[2] >= spread.max() > 0.0 else [0.0, 0.0, 1.0], (len(places), 1))


def mode_shapes(problem, posterior) -> xr.Dataset:
    """Mode shapes of the model at some draws, the first of which is the one nearest to the medians.

    Returns
    -------
    Dataset
        `shape` (sample, mode, point), each with a largest entry of 1 and with the sign of the first sample,
        and `frequency` (sample, mode) [Hz].
    """
    points, _ = points_of(problem)
    names = problem.structure.names
    table = np.column_stack([posterior[name].transpose("chain", "draw").values.ravel() for name in names])
    spread = np.where(table.std(axis=0) > 0.0, table.std(axis=0), 1.0)
    nearest = int((((table - np.median(table, axis=0)) / spread) ** 2).sum(axis=1).argmin())
    rows = [nearest, *np.linspace(0, len(table) - 1, SHAPES - 1).astype(int)]
    shapes, frequencies = [], []
    for row in table[rows]:
        try:
            structure = problem.structure(**dict(zip(names, map(float, row), strict=True)))
            found = modes_of(structure, problem.structure.n_modes)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError):
            continue
        entries = points.entries(found.mode_shapes.T[:MODES])
        largest = np.take_along_axis(entries, np.abs(entries).argmax(axis=1)[:, None], axis=1)
        entries = entries / np.where(largest == 0.0, 1.0, largest)
        if shapes:
            entries *= np.where((entries * shapes[0]).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
        shapes.append(entries)
        frequencies.append(found.natural_frequencies[:MODES])
    return xr.Dataset(
        {
            "shape": (("sample", "mode", "point"), np.array(shapes, dtype=np.float32)),
            "frequency": (("sample", "mode"), np.array(frequencies), {"units": "Hz"}),
        },
        {"mode": 1 + np.arange(len(frequencies[0]))},
    )
