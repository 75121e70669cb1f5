"""What is neither a number nor a text: flags, functions, mappings, results of samplers, models."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from pymc_features._checks.messages import message, shown
from pymc_features._checks.numeric import single

if TYPE_CHECKING:
    import pymc as pm
    import xarray as xr


def check_flag(value, name: str, advice: str = "") -> bool:
    """True or False."""
    if not isinstance(single(value), bool | np.bool_):
        raise TypeError(message(name, "True or False", shown(value), advice))
    return bool(value)


def check_callable(value, name: str, advice: str = "") -> Callable:
    """A function."""
    if not callable(value):
        raise TypeError(message(name, "a function", shown(value), advice))
    return value


def check_mapping(value, name: str, what: str, advice: str = "") -> dict:
    """A mapping with texts as keys, or None, as a new dict."""
    if value is None:
        return {}
    kinds = {kind.__name__ for kind in type(value).__mro__}
    plain = isinstance(value, Mapping) and not kinds & {"Dataset", "DataTree"}
    if not plain or not all(isinstance(key, str) for key in value):
        raise TypeError(message(name, what, shown(value), advice))
    return dict(value)


def check_group(tree, name: str, group: str, advice: str, *dims: str) -> "xr.Dataset":
    """A group of a DataTree, with these dimensions, as a Dataset."""
    import xarray as xr  # slow to import, and not needed to read a record

    if not isinstance(tree, xr.DataTree) or group not in tree.children:
        got = (
            f"one with {', '.join(tree.children) or 'none'}" if isinstance(tree, xr.DataTree) else shown(tree)
        )
        raise TypeError(message(name, f"a DataTree with a group `{group}`", got, advice))
    found = tree[group].to_dataset()
    missing = [dim for dim in dims if not found.sizes.get(dim)]
    if missing:
        raise ValueError(
            message(
                name,
                f"a DataTree whose `{group}` has values along {', '.join(dims)}",
                f"none along {missing[0]}",
                advice,
            )
        )
    return found


def check_model(model) -> "pm.Model":
    """The model given, or that of the context."""
    import pymc as pm  # slow to import

    if not (model is None or isinstance(model, pm.Model)):
        raise TypeError(message("model", "a pymc.Model", shown(model), "Leave it out in a model's context."))
    try:
        model = pm.modelcontext(model)
    except TypeError:
        advice = "Pass model=..., or call it within `with model:`."
        raise TypeError(message("model", "given outside of a model's context", "None", advice)) from None
    if not model.free_RVs:
        raise ValueError("`model` must have free parameters, got none. Declare variables without data.")
    return model
