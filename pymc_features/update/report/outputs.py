"""What an update leaves behind: netCDF with all that its report needs, tables, figures, and the report."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import xarray as xr

from pymc_features import plots
from pymc_features.exceptions import ConfigError
from pymc_features.plots.histories import record_of
from pymc_features.storage import netcdf_bytes, write_atomically
from pymc_features.update.kinds.base import kinds_of, png
from pymc_features.update.predictions import check_predictions, predictions
from pymc_features.update.problem import Problem, model_of, read_config
from pymc_features.update.report.document import document_of
from pymc_features.update.report.page import page_of, read_result
from pymc_features.update.templates.numbers import files_of, rows_of


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
    contents = {"update.nc": netcdf_bytes(result)} | files_of(rows)
    contents |= {f"figures/{name}.png": png(draw) for name, draw in figures(problem, result).items()}
    contents["report.html"] = page_of(result)
    for name, content in contents.items():
        raw = content if isinstance(content, bytes) else content.encode("utf-8")
        write_atomically(folder / name, lambda path, raw=raw: path.write_bytes(raw))
    return [folder / name for name in contents]


def figures(problem: Problem, result) -> dict[str, Callable]:
    """Names of every figure of the report to functions that draw; nothing is drawn yet."""
    found = {}
    if "gain" in result.children.get("data", {}):
        found = {"record": partial(plots.record, result)}
        found["frequencies"] = partial(plots.natural_frequencies, result)
    for kind in kinds_of(result):
        part = result[kind]
        own = {"prior_posterior": partial(plots.prior_posterior, part, units=problem.units)}
        for data in problem.shown:
            own |= data.figures_of(problem, part, kind)
        if "sample_stats" in part.children and part["sample_stats"].sizes.get("stage", 0) > 1:
            own["stages"] = partial(plots.tempering, part)
        if part["posterior"].sizes["chain"] > 1:
            own["ranks"] = partial(plots.chains, part, "rank")
        if part.attrs["method"] == "NUTS":
            own["traces"] = partial(plots.chains, part, "trace")
        found |= {f"{kind}_{name}": draw for name, draw in own.items()}
    return found


def predict_stored(config_path: Path, file: Path) -> xr.DataTree:
    """A stored result with the predictions that its configuration asks for now, in place of those before.

    Nothing is sampled, and no measured channel is read. `file` is the `update.nc` of a finished update.
    """
    config, _ = read_config(config_path)
    structure = model_of(config, config_path.parent)
    check_predictions(config, structure)
    if not config.predict:
        raise ConfigError("`predict` must be given, got none: a table [[predict]] for each motion.")
    if not file.is_file():
        raise ConfigError(
            f"`--out` must hold the result of an update, got no {file}. Run `pymc-features update` first."
        )
    result = read_result(file, "--out")
    posterior, measured = result[kinds_of(result)[0]]["posterior"].to_dataset(), None
    if missing := sorted(set(structure.names) - set(posterior.data_vars)):
        raise ConfigError(
            f"`structure` must be that of the result, {file} has no draws of {', '.join(missing)}. Run "
            "`pymc-features update` again."
        )
    if "ground_acceleration" in result.children.get("data", {}):
        measured = record_of(result)
    result = result.drop_nodes("predict", errors="ignore")
    for name, group in predictions(config, config_path.parent, structure, posterior, measured).items():
        result[f"predict/{name}"] = xr.DataTree(group)
    return result
