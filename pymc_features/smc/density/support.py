"""What a model's densities are where the prior of a variable is zero: nothing else is evaluated there."""

from contextlib import suppress

import numpy as np
import pytensor.tensor as pt
from pymc.vartypes import discrete_types
from pytensor.graph.replace import clone_replace
from pytensor.graph.traversal import ancestors
from pytensor.tensor import TensorConstant

from pymc_features.smc.density.prior import prior_draws


def inside_support(model, point, terms) -> tuple[list, list]:
    """The terms, with -inf for the prior outside of its support, and what they depend on instead.

    Discrete variables move on the real line and are rounded. They and others without a transform may be
    proposed where their prior is zero, and what comes after may have no value there: an index leads to no
    place. There, the rest is evaluated at a draw from the prior.
    """
    inputs, values, inside, possible = {v: v for v in model.value_vars}, {}, [], {}
    for rv in model.free_RVs:  # parents come before those that depend on them
        v = model.rvs_to_values[rv]
        is_discrete = v.dtype in discrete_types
        if not is_discrete and model.rvs_to_transforms[rv] is not None:
            continue
        [own] = model.logp(vars=[rv], sum=False)
        if not (is_discrete or has_edges(own)):
            continue
        possible = possible or possible_values(model, point)
        inputs[v] = pt.tensor(v.name, dtype="floatX" if is_discrete else v.dtype, shape=v.type.shape)
        value = pt.round(inputs[v]).astype(v.dtype) if is_discrete else inputs[v]
        allowed = pt.neq(clone_replace(own, values | {v: value}, rebuild_strict=False), -np.inf)
        inside.append(allowed.all())
        allowed = pt.shape_padright(allowed, v.ndim - allowed.ndim)
        values[v] = pt.switch(allowed, value, possible[v.name].astype(v.dtype)).astype(v.dtype)
    if inside:
        prior, *rest = clone_replace(list(terms), values, rebuild_strict=False)
        terms = [pt.switch(pt.all(inside), prior, -np.inf), *rest]
    return list(terms), list(inputs.values())


def has_edges(logp) -> bool:
    """Whether a log-density is -inf somewhere, by a constant in its graph."""
    constants = [v.data for v in ancestors([logp]) if isinstance(v, TensorConstant)]
    return any(np.isneginf(c).any() for c in constants)


def possible_values(model, point) -> dict[str, np.ndarray]:
    """One draw from the prior; the given `point` where there are no draws."""
    with suppress(NotImplementedError):
        drawn = prior_draws(model, True)(1, np.random.default_rng(0))
        return {
            model.rvs_to_values[rv].name: values[0] for rv, values in zip(model.free_RVs, drawn, strict=True)
        }
    return {name: np.asarray(value) for name, value in point.items()}
