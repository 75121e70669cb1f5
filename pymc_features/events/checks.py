"""What several events must be, and their draws as arrays."""

import numpy as np
import pymc as pm
import xarray as xr

from pymc_features._checks import as_list, check_group, message, shown

SAMPLE_THEM = "Pass what `sample` returned for each event."


def check_hyper(hyper) -> pm.Model:
    """The population model."""
    if not isinstance(hyper, pm.Model):
        raise TypeError(message("hyper", "a pymc.Model of the population", shown(hyper)))
    if not hyper.free_RVs:
        raise ValueError(message("hyper", "a model with free variables", "none"))
    return hyper


def check_models(models, events) -> list[pm.Model] | None:
    """The events' models, as many as there are posteriors."""
    if models is None:
        return None
    listed = as_list(models)
    if listed is None or not all(isinstance(model, pm.Model) for model in listed):
        raise TypeError(
            message("models", "a sequence of pymc.Model", shown(models), "Pass one of each event.")
        )
    if len(listed) != len(events):
        raise ValueError(message("models", f"as many as `events`, {len(events)}", len(listed)))
    return listed


def check_events(events) -> list[xr.DataTree]:
    """Two or more posteriors, as a list."""
    listed = None if isinstance(events, xr.DataTree) else as_list(events)
    if listed is None or len(listed) < 2:
        got = shown(events) if listed is None else len(listed)
        raise TypeError(message("events", "a sequence of two or more posteriors", got, SAMPLE_THEM))
    for event in listed:
        check_group(event, "events", "posterior", SAMPLE_THEM, "chain", "draw")
    return listed


def shared_names(hyper: pm.Model, events) -> list[str]:
    """Variables of the population model that each event has."""
    free = [rv.name for rv in hyper.free_RVs]
    names = [name for name in free if all(name in event["posterior"].data_vars for event in events)]
    if not names or len(names) == len(free):
        wanted = "one with free variables that the events have, and others that these depend on"
        got = f"{', '.join(free)}, of which the events have {', '.join(names) or 'none'}"
        raise ValueError(message("hyper", wanted, got, "Call them by the names of the events' parameters."))
    return names


def flat_draws(x: xr.DataArray) -> np.ndarray:
    """Draws (draw, ...) of all chains."""
    values = x.transpose("chain", "draw", ...).values
    return values.reshape(-1, *values.shape[2:])


def number_draws(posterior: xr.Dataset) -> dict[str, np.ndarray]:
    """Draws (draw, ...) of all variables that are numbers along chain and draw."""
    return {
        name: flat_draws(x)
        for name, x in posterior.data_vars.items()
        if {"chain", "draw"} <= set(x.dims) and x.dtype.kind in "biuf"
    }
