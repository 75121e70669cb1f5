"""The way between the unit cube and the parameters of a model, by the prior's distribution functions."""

from typing import NamedTuple

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pymc.logprob.utils import local_remove_check_parameter
from pytensor.graph.basic import Variable
from pytensor.graph.fg import FunctionGraph
from pytensor.graph.replace import graph_replace
from pytensor.graph.rewriting.basic import dfs_rewriter

from pymc_features._checks import message
from pymc_features.inference.parameters import Unconstrained
from pymc_features.smc import Outputs, RowFunction, batched_graph


class UnitCube(NamedTuple):
    """Compiled functions of rows (n, d).

    Attributes
    ----------
    to_theta : RowFunction
        From the unit cube to the unconstrained scale.
    from_theta : RowFunction
        Back.
    """

    to_theta: RowFunction
    from_theta: RowFunction


def unit_cube(model: pm.Model, space: Unconstrained, compile_kwargs: dict) -> UnitCube:
    """Rosenblatt's transform of the prior: each parameter by its distribution given those it depends on.

    Raises
    ------
    ValueError
        If PyMC cannot invert the distribution function of a prior, or entries of a prior are dependent.
    """
    refused = [rv for rv in model.free_RVs if not has_inverse(rv, model.rvs_to_transforms[rv])]
    if refused:
        got = ", ".join(f"{rv.name} ({rv.owner.op.name})" for rv in refused)
        advice = "Write the prior in parameters with independent priors, for example standard normal ones."
        expected = "one whose priors have inverse distribution functions, for the unit cube"
        raise ValueError(message("model", expected, got, advice))
    return UnitCube(
        compiled(*graph_to_theta(model, space), compile_kwargs),
        compiled(*graph_from_theta(model, space), compile_kwargs),
    )


def has_inverse(rv, transform) -> bool:
    """Whether PyMC knows the distribution function of each entry of a random variable, and its inverse."""
    if getattr(rv.owner.op, "ndim_supp", 0) or getattr(transform, "ndim_supp", 0):
        return False
    try:
        pm.icdf(rv, rv), pm.logcdf(rv, rv)
    except (NotImplementedError, ValueError):
        return False
    return True


def parts_of(vector: Variable, space: Unconstrained) -> dict[str, Variable]:
    """Parts of a flat vector, in the shapes of the value variables."""
    parts, first = {}, 0
    for name, shape in space.shapes.items():
        size = int(np.prod(shape, dtype=int))
        parts[name] = vector[first : first + size].reshape(shape)
        first += size
    return parts


def graph_to_theta(model, space) -> tuple[Variable, Variable]:
    """A vector u (d,) and theta (d,)."""
    u = pt.vector("u")
    parts, own, theta = parts_of(u, space), {}, []
    for rv in model.free_RVs:  # parents come before those that depend on them
        x = pm.icdf(rv, parts[model.rvs_to_values[rv].name])
        transform = model.rvs_to_transforms[rv]
        moved = x if transform is None else transform.forward(x, *rv.owner.inputs)
        own[rv], moved = graph_replace([x, moved], own, strict=False) if own else (x, moved)
        theta.append(moved.ravel())
    return u, pt.concatenate(theta)


def graph_from_theta(model, space) -> tuple[Variable, Variable]:
    """A vector theta (d,) and u (d,)."""
    theta = pt.vector("theta")
    parts = parts_of(theta, space)
    below = model.replace_rvs_by_values([pt.exp(pm.logcdf(rv, rv)).ravel() for rv in model.free_RVs])
    values = {model.rvs_to_values[rv]: parts[model.rvs_to_values[rv].name] for rv in model.free_RVs}
    return theta, pt.concatenate(graph_replace(below, values, strict=False))


def compiled(vector: Variable, result: Variable, compile_kwargs: dict) -> RowFunction:
    """The function of rows; a row with invalid parameters does not raise."""
    graph = FunctionGraph([vector], [result], clone=True, copy_inputs=False)
    dfs_rewriter(local_remove_check_parameter).rewrite(graph)
    [vector], outputs = graph.inputs, list(graph.outputs)
    return RowFunction(batched_graph(Outputs(vector, outputs)), compile_kwargs)
