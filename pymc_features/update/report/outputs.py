"""What an update leaves behind: netCDF with all that its report needs, tables, figures, and the report."""

import io
import json
from pathlib import Path

import numpy as np
import xarray as xr

from pymc_features import plots
from pymc_features.prediction.draws import structure_draws
from pymc_features.signals.spectra import averaged_spectra
from pymc_features.storage import netcdf_bytes, write_atomically
from pymc_features.update.kinds.nodes import Points
from pymc_features.update.kinds.structure import modes_of
from pymc_features.update.problem import Problem
from pymc_features.update.report.document import document_of
from pymc_features.update.report.figures import figures
from pymc_features.update.report.findings import Findings, findings
from pymc_features.update.report.numbers import as_csv, as_latex
from pymc_features.update.report.page import page_of
from pymc_features.update.report.summary import kinds_of

DPI = 110
HISTORIES = 200  # draws whose responses are kept
COMPONENTS, HELD = 6, 0.999  # at most so many, or as many as hold this share of their variance
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
    for figure in figures(problem, result, found.modes):
        image = png(figure.draw())
        writers[f"figures/{figure.name}.png"] = lambda path, image=image: path.write_bytes(image)
    writers["report.html"] = lambda path: path.write_text(page_of(saved), encoding="utf-8")
    for name, write in writers.items():
        write_atomically(folder / name, write)
    return [folder / name for name in writers]


def png(axes) -> bytes:
    """A figure as a PNG file; it is released."""
    buffer = io.BytesIO()
    axes[0].figure.savefig(buffer, dpi=DPI, format="png")
    plots.close(axes[:1])
    return buffer.getvalue()


def with_document(problem: Problem, result, found: Findings, warnings) -> xr.DataTree:
    """The result with the attribute `document` and with what figures need besides.

    Parameters
    ----------
    problem, result, found, warnings
        As of `document_of`.

    Returns
    -------
    DataTree
        Of each likelihood also `histories`, responses of draws by their principal components, and
        `mode_shapes` of the model; `/geometry`, where its degrees of freedom are; of ambient vibration
        `/singular_values` of the channels; of identified modes their partners. The one given is as it was.
    """
    saved = result.copy()
    saved.attrs["document"] = json.dumps(document_of(problem, result, found, warnings))
    saved.attrs["units"] = json.dumps({name: problem.unit(name) for name in problem.priors})
    for kind in kinds_of(result):
        posterior = result[kind]["posterior"].to_dataset()
        if problem.measured is not None:
            saved[f"{kind}/histories"] = xr.DataTree(histories(problem, result[kind]))
        if not problem.is_cyclic:
            saved[f"{kind}/mode_shapes"] = xr.DataTree(mode_shapes(problem, posterior))
        if kind in found.modes:
            rows = found.modes[kind]
            partners = [row.partner if row.has_partner else 0 for row in rows]
            matched = (
                result[f"{kind}/matched"]
                .to_dataset()
                .assign(
                    partner=("identified", np.array(partners)),
                    label=("identified", [row.name for row in rows]),
                )
            )
            saved[f"{kind}/matched"] = xr.DataTree(matched)
    if not problem.is_cyclic:
        saved["geometry"] = xr.DataTree(geometry(problem))
    if problem.ambient is not None:
        saved["singular_values"] = xr.DataTree(singular_values(problem.ambient))
    return saved


def histories(problem, part) -> xr.Dataset:
    """Responses of some draws, less their median, by principal components.

    The deviations D (sensor and time, draw) have the Gram matrix D'D = V diag(s^2) V'; the components are
    U = D V with the largest s, and a draw is the median plus U times its row of V. So a page can show the
    response of any of these draws without holding all of them.

    Returns
    -------
    Dataset
        `component` (component, sensor, time), `coefficient` (sample, component), with `chain` and `draw` of
        each sample, and the share of the variance that is held in `attrs`.
    """
    measured, name = problem.measured, problem.first.quantity
    median = part["bands"]["response"].sel(quantile=0.5, drop=True)
    settings = {"dt": measured.step, "n_modes": problem.structure.n_modes, "sensors": problem.dofs}
    drawn = structure_draws(
        part["posterior"].to_dataset(),
        problem.structure,
        [measured.record],
        [name],
        HISTORIES,
        0,
        keep_histories=True,
        **settings,
    )
    with drawn as chosen:
        gram = sum(np.einsum("rta,rtb->ab", d, d) for _, d in deviations(chosen, name, measured, median))
        squares, vectors = np.linalg.eigh(gram)
        squares, vectors = np.maximum(squares[::-1], 0.0), vectors[:, ::-1]
        total = squares.sum()
        share = np.cumsum(squares) / total if total > 0.0 else np.ones(len(squares))
        n = min(int(np.searchsorted(share, HELD)) + 1, COMPONENTS, len(squares))
        component = np.zeros((n, *median.shape), np.float32)
        for first, block in deviations(chosen, name, measured, median):
            component[:, :, first : first + block.shape[1]] = np.einsum("rts,sc->crt", block, vectors[:, :n])
        labels = chosen.labels
    return xr.Dataset(
        {
            "component": (("component", *median.dims), component),
            "coefficient": (("sample", "component"), vectors[:, :n]),
        },
        {"sensor": median["sensor"], "time": median["time"], **labels},
        {"share": float(share[n - 1])},
    )


def deviations(chosen, name, measured, median):
    """Yield (first compared sample, responses less the median (sensor, time, draw)), block by block."""
    compared = np.arange(len(chosen.ensemble.times(0)))[measured.compared]
    for first, values in chosen.ensemble.blocks(0, name):
        inside = compared[(compared >= first) & (compared < first + values.shape[1])]
        if inside.size:
            start = int(inside[0] - compared[0])
            block = slice(start, start + inside.size)
            yield start, values[:, inside - first] - median.values[:, block, None]


def points_of(problem) -> tuple[Points, str]:
    """What is drawn of a mode shape, and how: storeys, nodes of a file, or entries along their numbers."""
    modal, section = problem.modal, problem.structure
    expected = section(**{name: problem.priors[name].median for name in section.names})
    if modal is not None and modal.points is not None and modal.points.nodes is not None:
        return modal.points, "nodes"
    kept = np.unique(np.linspace(0, expected.n_dof - 1, min(expected.n_dof, MOST_POINTS)).astype(int))
    kept = np.union1d(kept, problem.dofs or (modal.dofs if modal is not None else [])).astype(int)
    return Points(kept, None), "storeys" if section.type.has_storeys else "entries"


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
    named = {}
    if problem.measured is not None or problem.ambient is not None:
        named = dict(zip(problem.config.data.sensors, problem.dofs, strict=True))
    elif problem.modal is not None:
        named = dict(zip(problem.modal.data.channels, problem.modal.dofs, strict=True))
    held = points.dofs.tolist()
    sensors = {name: held.index(dof) for name, dof in named.items() if dof in held}
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


def singular_values(ambient) -> xr.Dataset:
    """Those of the spectra of the channels, averaged over twenty parts of the record, and the bands [Hz]."""
    spectra = averaged_spectra(ambient.channels.values, ambient.step)
    values = (("value", "frequency"), spectra.singular_values[1:].T, {"units": "(m/s^2)^2/Hz"})
    return xr.Dataset(
        {"singular_value": values, "band": (("band", "end"), np.asarray(ambient.bands))},
        {"frequency": spectra.frequencies[1:]},
    )
