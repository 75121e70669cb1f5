"""The axes of a likelihood: their names, the order of labelled data, and the times where nobody says them."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant, Variable

from pymc_features._checks import listed, message, shown
from pymc_features.ops.response import response_step
from pymc_features.structures.base import as_tensor


def check_dims(dims, ndim: int | None = None) -> tuple | None:
    """Names of axes as a tuple, or None; as many as the data have axes, where that is known."""
    listed = (dims,) if isinstance(dims, str) else dims
    if listed is None:
        return None
    if not isinstance(listed, list | tuple) or not all(
        name is None or name is ... or isinstance(name, str) for name in listed
    ):
        raise TypeError(
            f"`dims` must be the names of the axes of the data, got {shown(dims)}. Pass for example "
            '("sensor", "time").'
        )
    if ndim is not None and ... not in listed and len(listed) != ndim:
        raise ValueError(f"`dims` must name the {ndim} axes of the data, got {shown(dims)}.")
    return tuple(listed)


def known_dims(dims, ndim: int | None = None) -> tuple | None:
    """Return the dims; refuse what the model of the context does not know."""
    dims, lengths = check_dims(dims, ndim), pm.modelcontext(None).dim_lengths
    unknown = [name for name in dims or () if isinstance(name, str) and name not in lengths]
    if unknown:
        advice = f'Declare it, as in pm.Model(coords={{"{unknown[0]}": range(n)}}).'
        raise ValueError(message("dims", "dimensions of the model", shown(unknown[0]), advice))
    return dims


def name_the_time_axis(dims, mu, observed, dt=None):
    """Give the model the times [s] of the last dimension, where `dims` names one it does not know.

    `dt` [s] counts where it is a constant; else the output step of a response, if that is known.
    """
    dims, model = check_dims(dims) or (), pm.modelcontext(None)
    known_dims(dims[:-1])
    if not dims or dims[-1] in (None, ...) or dims[-1] in model.dim_lengths:
        return
    mu = as_tensor(mu, "mu")
    n_times = mu.type.shape[-1] if mu.ndim else None
    if n_times is None and observed is not None:
        observed = pt.as_tensor_variable(observed)
        known = isinstance(observed, SharedVariable)
        n_times = observed.get_value(borrow=True).shape[-1] if known else observed.type.shape[-1]
    if n_times is not None:
        step = float(dt.data) if isinstance(dt, Constant) else response_step(mu) or 1
        model.add_coord(dims[-1], np.arange(n_times) * step)


def by_labels(observed, dims=None, axes=("sensor", "time")):
    """Labelled data in the order of the likelihood's axes and of the model's coordinates; others as they are.

    Parameters
    ----------
    observed : object
        A DataArray is turned and reordered. `pm.Data` along axes in another order is refused.
    dims : sequence of str, optional
        What the user calls the axes.
    axes : tuple of str
        What the last axes are called otherwise.
    """
    if isinstance(observed, Variable) and observed.name:
        names = pm.modelcontext(None).named_vars_to_dims.get(observed.name, ())
        order = order_of(names, dims, axes) or []
        if order != sorted(order):
            turned = listed([names[k] for k in order])
            raise ValueError(
                f"`observed` must be pm.Data along {turned}, got {listed(names)}. Declare it in this order."
            )
    if not isinstance(observed, xr.DataArray) or all(str(d).startswith("dim_") for d in observed.dims):
        return observed
    order = order_of(observed.dims, dims, axes)
    if order is None:
        raise ValueError(
            f"`observed` must be along {listed(axes)}, got {listed(observed.dims)}. Rename its dimensions "
            "with observed.rename(), or pass observed.values."
        )
    observed = observed.transpose(*(observed.dims[k] for k in order))
    for k, name in enumerate(observed.dims):
        if name in observed.indexes:
            called = [*(check_dims(dims) or ())][k : k + 1] + [*axes[k - observed.ndim :][:1], name]
            observed = in_order(observed, name, list(observed.indexes[name]), called)
    return observed


def order_of(names, dims, axes) -> list[int] | None:
    """Which of the `names` stands on each axis; None where two of them or more are unknown."""
    n = len(names)
    given = check_dims(dims) or ()
    places = {name: n - k for k, name in enumerate(reversed(axes), 1) if k <= n}
    if len(given) == n:
        places |= {name: k for k, name in enumerate(given) if isinstance(name, str)}
    free = set(range(n)) - {places[name] for name in names if name in places}
    found = [places.get(name, min(free, default=0)) for name in names]
    return sorted(range(n), key=found.__getitem__) if sorted(found) == list(range(n)) else None


def in_order(observed, name, labels, called):
    """The data with the labels along one axis in the order of the model, that of one it is `called`."""
    if name == "time":
        if not observed.indexes[name].is_monotonic_increasing:
            raise ValueError(
                '`observed` must have increasing times, got others. Sort them with observed.sortby("time").'
            )
        return observed
    model = pm.modelcontext(None)
    wanted = next((list(model.coords[a]) for a in called if a in model.coords and model.coords[a]), labels)
    if labels == wanted:
        return observed
    if len(set(labels)) == len(labels) and set(labels) == set(wanted):
        return observed.isel({name: [labels.index(x) for x in wanted]})
    numbered = list(range(len(labels)))  # says nothing but the place
    if set(labels).isdisjoint(wanted) and numbered in (labels, wanted):
        return observed
    raise ValueError(
        f"`observed` must have the model's labels along {name}, {listed(wanted)}, got {listed(labels)}. "
        "Select and rename them, or pass observed.values."
    )
