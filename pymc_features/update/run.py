"""From a problem to its result: what is sampled, what all likelihoods share, predictions and comparisons."""

import json
from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path

import xarray as xr

from pymc_features.exceptions import ConfigError
from pymc_features.records import Record
from pymc_features.update.candidates import candidates_of, compared
from pymc_features.update.document import read_config
from pymc_features.update.parts import RunSettings, run_parts
from pymc_features.update.population import members_of, populations
from pymc_features.update.predictions import check_predictions, predictions
from pymc_features.update.problem import Problem, model_of


def run_update(
    problem: Problem,
    *,
    out=None,
    cores: int | None = None,
    executor: int | str | Executor | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    progressbar: bool = True,
) -> xr.DataTree:
    """Sample the posterior of every likelihood, and predict with it.

    Parameters
    ----------
    problem : Problem
        From `read_problem`.
    out : path, optional
        Folder in which each finished likelihood is kept at once; a second call with the same problem
        continues. Other likelihoods, another tolerance, report or `cores` are no other problem.
    cores : int, optional
        Processes; as the configuration says, or all processors.
    executor : int, str, dask Client or Executor, optional
        Where populations are evaluated, as of `sample_smc`; `cores` then says how many chains run at once.
    progress : callable (str, int, int), optional
        Called with the name of the likelihood in work, the number finished, and the number in all.
    progressbar : bool
        Whether each likelihood shows PyMC's own progress bar.

    Returns
    -------
    DataTree
        For each likelihood `/<kind>/`, CAL first: posterior, prior, sample_stats, observed_data, bands,
        modal, and of CAL calibration, what `effective_samples` returns. And `/data`: motion of the base,
        measured responses and their gain; of a cyclic test force and displacement, and no modal. Of
        identified modes `/identified`, and in each likelihood `matched`, which mode each is matched with, and
        `shapes` of draws; without responses the only likelihood is MODAL, and there are neither data nor
        bands. Of ambient vibration the likelihood is AMBIENT, with `spectra`, see `fitted_spectra`, and with
        the modes that the channels have. Of several events `sequence`, and all else is the state after the
        last of them. `/predict/<name>` has what [[predict]] asks for, see `predictions`, and
        `/compare/<likelihood>` the evidence of the candidates of [compare], `/hierarchical/<likelihood>` the
        population of [hierarchical]. The attribute `failed` says in
        JSON which calibrated posterior could not be had, and why; if it was the only one asked for, that
        which it is made from is in its place.

    Raises
    ------
    ConfigError
        If `out` holds another problem, or the tolerance of ABC is out of reach; everything else is kept.
    """
    candidates, members = candidates_of(problem), members_of(problem)  # whose errors come before any draw
    settings = RunSettings(out, cores, executor, progress, progressbar)
    parts, failed = run_parts(problem, settings)
    reported = [kind for kind in problem.reported if kind in parts] or list(parts)
    shown = {kind: parts[kind].copy() for kind in reported}
    title = problem.config.report.title.replace("/", "-")  # which would be a path in the tree
    result = xr.DataTree.from_dict(shown, name=title)
    groups = compared(problem, candidates, parts, settings)
    groups |= populations(problem, members, parts, settings)
    for data in problem.data:
        groups |= data.shared(problem, shown)
    posterior = shown[reported[0]]["posterior"].to_dataset()
    motion = None if problem.measured is None else problem.measured.record
    predicted = predictions(problem.config, problem.path.parent, problem.structure, posterior, motion)
    for name, group in predicted.items():
        groups[f"predict/{name}"] = group
    for path, group in groups.items():
        result[path] = xr.DataTree(group)
    result.attrs["failed"] = json.dumps(failed)
    return result


def predict_stored(config_path: Path, file: Path) -> xr.DataTree:
    """A stored result with the predictions that its configuration asks for now, in place of those before.

    Nothing is sampled, and no measured channel is read.

    Parameters
    ----------
    config_path : Path
        The configuration file.
    file : Path
        `update.nc` of a finished update.

    Raises
    ------
    ConfigError
        If nothing is asked for, there is no result, or it is one of another structure.
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
    with xr.open_datatree(file, engine="h5netcdf") as tree:
        result = tree.load()
    if "document" not in result.attrs:
        raise ConfigError(
            f"`--out` must hold the result of an update with its report, {file} has none. Run `pymc-features "
            "update` again: finished likelihoods are kept."
        )
    first = next(node for node in result.children.values() if "posterior" in node.children)
    posterior, measured = first["posterior"].to_dataset(), None
    if missing := sorted(set(structure.names) - set(posterior.data_vars)):
        raise ConfigError(
            f"`structure` must be that of the result, {file} has no draws of {', '.join(missing)}. Run "
            "`pymc-features update` again."
        )
    if "ground_acceleration" in result.children.get("data", {}):
        motion = result["data/ground_acceleration"]
        dt = float(motion["record_time"][1] - motion["record_time"][0])
        about = result["data"].attrs
        measured = Record(motion.values, dt, about["record"], interpolation=about["interpolation"])
    result = result.drop_nodes("predict", errors="ignore")
    for name, group in predictions(config, config_path.parent, structure, posterior, measured).items():
        result[f"predict/{name}"] = xr.DataTree(group)
    return result
