"""What declarations of variables ask of numbers, and of values at the initial point of a model."""

import numpy as np
import pymc as pm
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant
from pytensor.graph.traversal import ancestors
from pytensor.tensor import TensorVariable

from pymc_features._checks import message, shown
from pymc_features.structures.base import IN_PYTHON, as_tensor


def positive_tensor(
    value, name: str, advice: str = "", *, zero: bool = False, data: bool = False, words: str = "positive"
) -> TensorVariable:
    """A tensor; numbers, and with `data` values of `pm.Data`, are refused where not positive and finite.

    With `zero` that is allowed, too; `words` say what numbers must be.
    """
    tensor = as_tensor(value, name, advice)
    values = np.ones(())
    if isinstance(tensor, Constant):
        values = np.asarray(tensor.data)
    elif data and isinstance(tensor, SharedVariable):
        values = np.asarray(tensor.get_value())
    if not (np.isfinite(values) & ((values > 0) | (zero & (values == 0)))).all():
        raise ValueError(message(name, f"{words} and finite", shown(values.tolist()), advice))
    return tensor


def values_at_start(variables, model: pm.Model | None = None) -> list[np.ndarray]:
    """Values of variables at the initial point of a model, by default of the context."""
    model = pm.modelcontext(model)
    function = model.compile_fn(
        model.replace_rvs_by_values(variables),
        inputs=model.value_vars,
        mode=IN_PYTHON,
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
