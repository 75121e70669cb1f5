"""From a problem to its result: what is sampled, what all likelihoods share, predictions and comparisons."""

import json
from collections.abc import Callable
from concurrent.futures import Executor

import xarray as xr

from pymc_features.update.comparisons import candidates_of, compared, members_of, populations
from pymc_features.update.kinds.shapes import geometry, mode_shapes
from pymc_features.update.predictions import predictions
from pymc_features.update.problem import Problem
from pymc_features.update.sampling import Running, run_parts


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
        modal, mode_shapes, histories (responses of draws by their principal components), and of CAL
        calibration, what `effective_samples` returns. And `/data`: motion of the base,
        measured responses and their gain; of a cyclic test force and displacement, and no modal. Of
        identified modes `/identified`, and in each likelihood `matched`, which mode each is matched with;
        without responses the only likelihood is MODAL, and there are neither data nor
        bands. Of ambient vibration the likelihood is AMBIENT, with `spectra`, see `fitted_spectra`, and with
        the modes that the channels have. Of several events `sequence`, and all else is the state after the
        last of them. Of a structure with modes `/geometry`, where its degrees of freedom are.
        `/predict/<name>` has what [[predict]] asks for, see `predictions`, and
        `/compare/<likelihood>` the evidence of the candidates of [compare], `/hierarchical/<likelihood>` the
        population of [hierarchical]. The attribute `failed` says in
        JSON which calibrated posterior could not be had, and why; if it was the only one asked for, that
        which it is made from is in its place. `units` are those of the parameters.

    Raises
    ------
    ConfigError
        If `out` holds another problem, or the tolerance of ABC is out of reach; everything else is kept.
    """
    candidates, members = candidates_of(problem), members_of(problem)  # whose errors come before any draw
    running = Running(out, cores, executor, progress, progressbar)
    parts, failed = run_parts(problem, running)
    reported = [kind for kind in problem.reported if kind in parts] or list(parts)
    title = problem.config.report.title.replace("/", "-")  # which would be a path in the tree
    result = xr.DataTree.from_dict({kind: parts[kind].copy() for kind in reported}, name=title)
    posteriors = {kind: parts[kind]["posterior"].to_dataset() for kind in reported}
    groups = compared(problem, candidates, parts, running)
    groups |= populations(problem, members, parts, running)
    for data in problem.shown:
        groups |= data.shared(problem)
    if problem.structure.has_modes:  # not kept in parts: other nodes are no other draws
        groups["geometry"] = geometry(problem)
        groups |= {f"{kind}/mode_shapes": mode_shapes(problem, one) for kind, one in posteriors.items()}
    motion = None if problem.measured is None else problem.measured.record
    settings = problem.config, problem.folder, problem.structure, posteriors[reported[0]], motion
    groups |= {f"predict/{name}": group for name, group in predictions(*settings).items()}
    for path, group in groups.items():
        result[path] = xr.DataTree(group)
    result.attrs["failed"] = json.dumps(failed)
    result.attrs["units"] = json.dumps(problem.units)
    return result
