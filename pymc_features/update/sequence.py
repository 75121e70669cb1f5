"""Sampling one likelihood of several events, one after another."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import xarray as xr

from pymc_features.events.sequence.run import states_in_sequence
from pymc_features.exceptions import ConfigError, StudyMismatchError
from pymc_features.smc import Workers
from pymc_features.update.problem.model import declare
from pymc_features.update.problem.read import Problem

FOLDER = "sequence"  # beside the parts of an update


class Running(NamedTuple):
    """How a likelihood is run; nothing of it changes a draw.

    Attributes
    ----------
    cores : int or None
        Processes.
    workers : Workers or None
        Where populations are evaluated.
    progressbar : bool
        Whether to show PyMC's own.
    out : path or None
        Folder of the update.
    tell : callable (str)
        Called with what is in work.
    """

    cores: int | None
    workers: Workers | None
    progressbar: bool
    out: object
    tell: Callable[[str], None]


def sample_events(problem: Problem, kind: str, seed: int, running: Running) -> xr.DataTree:
    """The posterior after the last event; that after each one is kept in a folder for each likelihood.

    Parameters
    ----------
    problem : Problem
        With events.
    kind : str
        The likelihood.
    seed : int
        For the same draws each time.
    running : Running
        `tell` is called with the name of each event before it is sampled.

    Returns
    -------
    DataTree
        As of `sample_in_sequence`, the events in `sequence` with their names.

    Raises
    ------
    ConfigError
        If a posterior cannot be sampled.
    StudyMismatchError
        If the folder holds other events.
    """
    asked, sampler = problem.config.events, problem.config.sampler
    models = [declare(problem.at(event), kind) for event in problem.events]
    free = {rv.name for rv in models[0].free_RVs}
    states = states_in_sequence(
        models,
        out=None if running.out is None else Path(running.out) / FOLDER / kind,
        draws=sampler.draws,
        chains=sampler.chains,
        random_seed=seed,
        cores=running.cores or sampler.cores,
        executor=running.workers,
        progressbar=running.progressbar,
        drift={name: value for name, value in asked.drift.items() if name in free},
        forgetting=asked.forgetting,
        change=asked.change,
    )
    try:
        for event in problem.events:
            running.tell(f"{kind}, {event.name}")
            idata = next(states)
    except StudyMismatchError:
        raise
    except ValueError as error:
        raise ConfigError(
            f"`priors` must lead to posteriors that can be sampled, after {event.name}: {error}"
        ) from error
    names = [event.name for event in problem.events]
    idata["sequence"] = xr.DataTree(idata["sequence"].to_dataset().assign_coords(name=("event", names)))
    return idata
