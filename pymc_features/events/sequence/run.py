"""`sample_in_sequence`: many events one after another, kept in a folder."""

import os
from collections import deque
from collections.abc import Iterator, Mapping, Sequence

import pymc as pm
import xarray as xr

from pymc_features._checks import as_list, check_integer, check_model, check_path, check_seed, message, shown
from pymc_features.events.sequence.continuing import continue_with, sequence_of
from pymc_features.exceptions import StudyMismatchError
from pymc_features.inference.sample import sample
from pymc_features.smc import open_workers
from pymc_features.smc.kernels.checkpoint import model_fingerprint
from pymc_features.storage import PartStore

OF_RUN = ("drift", "forgetting", "change")  # of `continue_with` alone


def sample_in_sequence(
    events: Sequence[pm.Model | Mapping],
    *,
    model: pm.Model | None = None,
    out: str | os.PathLike | None = None,
    draws: int = 4000,
    chains: int = 2,
    random_seed: int = 0,
    **settings,
) -> xr.DataTree:
    """Sample the first event with its prior, and each that follows with the posterior of those before.

    Parameters
    ----------
    events : sequence of pymc.Model, or of dict
        A model for each event, or with `model` what `pymc.set_data` is to put into it: then nothing is
        compiled again from event to event.
    model : pymc.Model, optional
        With `pymc.Data`.
    out : path-like, optional
        Folder that keeps the posterior after each event. A run that was killed goes on from there, and so
        does one with more events at the end.
    draws, chains : int
        Of each posterior.
    random_seed : int
        For the same draws each time.
    **settings
        Of `continue_with`; those that `sample` has are for the first event, too.

    Returns
    -------
    DataTree
        As from `continue_with`, after the last event; of one event alone `sequence` has one entry.

    Raises
    ------
    StudyMismatchError
        If the folder holds other settings, or another event at some place.

    See Also
    --------
    plot_sequence : parameters and alarms, event by event.
    """
    with open_workers(settings.pop("executor", None)) as workers:
        if workers is not None:
            settings["executor"] = workers
        states = states_in_sequence(
            events, model=model, out=out, draws=draws, chains=chains, random_seed=random_seed, **settings
        )
        return deque(states, maxlen=1).pop()


def states_in_sequence(
    events, *, model=None, out=None, draws=4000, chains=2, random_seed=0, **settings
) -> Iterator[xr.DataTree]:
    """The posterior after each event, one by one; arguments as of `sample_in_sequence`."""
    listed = as_list(events)
    if not listed or not all(
        isinstance(event, Mapping if model is not None else pm.Model) for event in listed
    ):
        wanted = "a sequence of pymc.Model, or with `model` of dicts for pymc.set_data"
        raise TypeError(message("events", wanted, shown(events)))
    for name, value, least in (("draws", draws, 100), ("chains", chains, 1)):
        check_integer(value, name, least=least)
    check_seed(random_seed, several=False)
    if out is not None:
        check_path(out, "out")
    if model is not None:
        check_model(model)
    run = {"draws": int(draws), "chains": int(chains), "random_seed": random_seed}
    run |= {name: settings[name] for name in OF_RUN if name in settings}
    store, idata = PartStore(out, run, "sequence"), None
    for i, event in enumerate(listed):
        of_event = model if model is not None else event
        if model is not None:
            pm.set_data(event, model=model)
        name, print_ = f"{i:05d}", model_fingerprint(of_event)
        known = store.load(name)
        if known is not None and known.attrs["model"] != print_:
            raise StudyMismatchError(
                f"`out` must hold the same events, got {out} with another one at place {i}. Choose another "
                "folder, or delete this one."
            )
        if known is None:
            known = one_event(idata, of_event, i, run, settings)
            known.attrs["model"] = print_
            store.save(name, known)
        idata = known
        yield idata


def one_event(before, model, i: int, run: dict, settings: dict) -> xr.DataTree:
    """The posterior after event i."""
    seed = None if run["random_seed"] is None else run["random_seed"] + i
    if before is None:
        own = {name: value for name, value in settings.items() if name not in OF_RUN}
        first = sample(run["draws"], chains=run["chains"], model=model, random_seed=seed, **own)
        first["sequence"] = xr.DataTree(sequence_of(first, model))
        return first
    return continue_with(before, model=model, draws=run["draws"], random_seed=seed, **settings)
