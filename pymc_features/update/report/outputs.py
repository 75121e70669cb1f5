"""What an update leaves behind: netCDF with all that its report needs, tables, figures, and the report."""

import json
from pathlib import Path

from pymc_features import plots
from pymc_features.storage import netcdf_bytes, write_atomically
from pymc_features.update.kinds.base import Figure
from pymc_features.update.kinds.model import kinds_of
from pymc_features.update.problem import Problem
from pymc_features.update.report.document import document_of
from pymc_features.update.report.page import page_of
from pymc_features.update.templates.numbers import as_csv, as_latex, rows_of


def write_outputs(problem: Problem, result, folder, channel_warnings=()) -> list[Path]:
    """Write `update.nc`, `table.csv`, `table.tex`, the figures and `report.html`; return their paths.

    The page is made from what is written to `update.nc` alone: `pymc-features report` makes it again.

    Parameters
    ----------
    problem : Problem
        What was updated.
    result : DataTree
        From `run_update`. Its attribute `document` is made here, if it has none.
    folder : path
        Made if needed.
    channel_warnings : sequence of str
        What was said about the channels, and identified modes, when they were read.

    Returns
    -------
    list of Path
        The report last.
    """
    folder = Path(folder)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    if "document" not in result.attrs:
        result.attrs["document"] = json.dumps(document_of(problem, result, channel_warnings))
    rows = rows_of(json.loads(result.attrs["document"]))
    contents = {"update.nc": netcdf_bytes(result), "table.csv": as_csv(rows), "table.tex": as_latex(rows)}
    contents |= {f"figures/{figure.name}.png": figure.png() for figure in figures(problem, result)}
    contents["report.html"] = page_of(result)
    for name, content in contents.items():
        raw = content if isinstance(content, bytes) else content.encode("utf-8")
        write_atomically(folder / name, lambda path, raw=raw: path.write_bytes(raw))
    return [folder / name for name in contents]


def figures(problem: Problem, result) -> list[Figure]:
    """Every figure of the report; nothing is drawn yet."""
    found = [figure for data in problem.data for figure in data.figures(problem, result)]
    units = {name: problem.unit(name) for name in problem.priors}
    for kind in kinds_of(result):
        part = result[kind]
        found.append(
            Figure(
                f"{kind}_prior_posterior",
                f"{kind}: prior (grey) against posterior, each to its own height.",
                lambda part=part: plots.prior_posterior(part, units=units),
            )
        )
        found += [figure for data in problem.data for figure in data.figures_of(problem, part, kind)]
        found += of_run(part, kind)
    return found


def of_run(part, kind) -> list[Figure]:
    """How the sampler fared."""
    found = []
    if "sample_stats" in part.children and part["sample_stats"].sizes.get("stage", 0) > 1:
        words = (
            f"{kind}: the way from the prior, or from the first guess at the modes, to the posterior, and "
            "the acceptance of its moves."
        )
        found.append(Figure(f"{kind}_stages", words, lambda: plots.tempering(part)))
    if part["posterior"].sizes["chain"] > 1:
        words = (
            f"{kind}: density of each chain, and ranks of its draws; the curves of chains that agree stay "
            "near the middle (p: of a test that they do)."
        )
        found.append(Figure(f"{kind}_ranks", words, lambda: plots.chains(part, "rank")))
    if part.attrs["method"] == "NUTS":
        found.append(Figure(f"{kind}_traces", f"{kind}: traces.", lambda: plots.chains(part, "trace")))
    return found
