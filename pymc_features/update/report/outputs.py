"""What an update leaves behind: netCDF with all that its report needs, tables, figures, and the report."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

from pymc_features import plots
from pymc_features.storage import netcdf_bytes, write_atomically
from pymc_features.update.kinds.base import png
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
    contents |= {f"figures/{name}.png": png(draw) for name, draw in figures(problem, result).items()}
    contents["report.html"] = page_of(result)
    for name, content in contents.items():
        raw = content if isinstance(content, bytes) else content.encode("utf-8")
        write_atomically(folder / name, lambda path, raw=raw: path.write_bytes(raw))
    return [folder / name for name in contents]


def figures(problem: Problem, result) -> dict[str, Callable]:
    """Names of every figure of the report to functions that draw; nothing is drawn yet."""
    found = {}
    for data in problem.data:
        found |= data.figures(problem, result)
    units = {name: problem.unit(name) for name in problem.priors}
    for kind in kinds_of(result):
        part = result[kind]
        own = {"prior_posterior": partial(plots.prior_posterior, part, units=units)}
        for data in problem.data:
            own |= data.figures_of(problem, part, kind)
        if "sample_stats" in part.children and part["sample_stats"].sizes.get("stage", 0) > 1:
            own["stages"] = partial(plots.tempering, part)
        if part["posterior"].sizes["chain"] > 1:
            own["ranks"] = partial(plots.chains, part, "rank")
        if part.attrs["method"] == "NUTS":
            own["traces"] = partial(plots.chains, part, "trace")
        found |= {f"{kind}_{name}": draw for name, draw in own.items()}
    return found
