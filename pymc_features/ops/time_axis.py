"""The coordinates of the time axis, for models that name it without saying what it holds."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant

from pymc_features.ops.response import response_step


def name_the_time_axis(dims, mu, observed, dt=None):
    """Give the model the times [s] of the last dimension, where `dims` names one it does not know.

    `dt` [s] counts where it is a constant; else the output step of a response, if that is known.
    """
    dims = (dims,) if isinstance(dims, str) else tuple(dims or ())
    model = pm.modelcontext(None)
    if not dims or dims[-1] is None or dims[-1] in model.dim_lengths:
        return
    mu = pt.as_tensor_variable(mu)
    n_times = mu.type.shape[-1] if mu.ndim else None
    if n_times is None and observed is not None:
        observed = pt.as_tensor_variable(observed)
        known = isinstance(observed, SharedVariable)
        n_times = observed.get_value(borrow=True).shape[-1] if known else observed.type.shape[-1]
    if n_times is not None:
        step = float(dt.data) if isinstance(dt, Constant) else response_step(mu) or 1
        model.add_coord(dims[-1], np.arange(n_times) * step)
