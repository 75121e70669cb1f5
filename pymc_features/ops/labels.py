"""The order of labelled data: that of the axes of a likelihood, and of the sensors of the model."""

import pymc as pm
import xarray as xr
from pytensor.graph.basic import Variable

from pymc_features._checks import listed
from pymc_features.ops.time_axis import check_dims


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
