"""The coordinates of the time axis, for models that name it without saying what it holds."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant

from pymc_features._checks import message, shown
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
