"""Values at the initial point of a model, which warnings about a declaration look at."""

import numpy as np
import pymc as pm
from pytensor.graph.traversal import ancestors


def values_at_start(variables, model: pm.Model | None = None) -> list[np.ndarray]:
    """Values of variables at the initial point of a model, by default of the context."""
    model = pm.modelcontext(model)
    function = model.compile_fn(
        model.replace_rvs_by_values(variables),
        inputs=model.value_vars,
        mode="FAST_COMPILE",
        on_unused_input="ignore",
    )
    return function(model.initial_point())


def cheap_values_at_start(variables) -> list[np.ndarray] | None:
    """Values as of `values_at_start`, for a warning; None where they are expensive, or cannot be found.

    What cannot be evaluated at the initial point is no error of the user's.
    """
    if any(v.owner is not None and getattr(v.owner.op, "expensive", False) for v in ancestors(variables)):
        return None
    try:
        return values_at_start(variables)
    except Exception:
        return None
