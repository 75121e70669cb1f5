"""A model whose likelihood is stretched around its maximum, so that its curvature is another.

    ln L_cal(z) = power ln L(z_hat + C (z - z_hat)),

on the unconstrained scale, where every point is possible (Ribatet, Cooley & Davison, Stat. Sin. 22, 2012).
The prior is not touched: its bounds and its information keep their meaning.
"""

import copy

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
from pytensor.graph.replace import graph_replace

from pymc_features.calibration.sandwich import whitening

NAME = "calibrated_likelihood"
# what a model knows of its variables, besides those observed
SHARED = (
    "named_vars",
    "named_vars_to_dims",
    "values_to_rvs",
    "rvs_to_values",
    "rvs_to_transforms",
    "rvs_to_initial_values",
    "free_RVs",
    "deterministics",
    "potentials",
    "data_vars",
    "_dim_lengths",
)


def stretching(information: np.ndarray, precision: np.ndarray) -> tuple[float, np.ndarray]:
    """Power k and matrix C (d, d) with C' (k A) C = the wanted precision (d, d).

    C has determinant one. It is the unit matrix along directions that the likelihood does not tell.
    """
    whiten = whitening(information)  # W' A W = 1
    unwhiten = whiten.T @ information  # its inverse from the left
    relative = whiten.T @ precision @ whiten
    values, vectors = np.linalg.eigh(0.5 * (relative + relative.T))
    power = float(np.exp(np.mean(np.log(values))))
    along = (vectors * np.sqrt(values / power)) @ vectors.T
    return power, np.eye(len(information)) + whiten @ (along - np.eye(len(values))) @ unwhiten


def adjusted_model(model: pm.Model, point: np.ndarray, matrix: np.ndarray, power: float) -> pm.Model:
    """The model with the free parameters and priors of another, and its likelihood as a potential.

    Parameters
    ----------
    model : pymc.Model
    point : array (d,)
        z_hat, flat and unconstrained, in the order of the model's value variables.
    matrix : array (d, d)
        C.
    power : float
    """
    # shared variables: other values are no other code
    point, matrix, power = (pytensor.shared(np.asarray(x, dtype=np.float64)) for x in (point, matrix, power))
    stand_ins = {rv: rv.type(name=rv.name) for rv in model.free_RVs}
    terms = [pm.logp(rv, model.rvs_to_values[rv]).sum() for rv in model.observed_RVs]
    terms = graph_replace(terms, stand_ins, strict=False)
    moved = dict(zip(stand_ins.values(), stretched(model, point, matrix), strict=True))
    likelihood = power * pt.add(*graph_replace(terms, moved, strict=False), 0.0)
    return with_potential(model, likelihood)


def stretched(model, point, matrix) -> list:
    """Free parameters at z_hat + C (z - z_hat), as functions of those of the model."""
    transforms = [(rv, model.rvs_to_transforms[rv]) for rv in model.free_RVs]
    values = [rv if t is None else t.forward(rv, *rv.owner.inputs) for rv, t in transforms]
    flat = pt.concatenate([value.ravel() for value in values])
    moved, result, first = point + pt.dot(matrix, flat - point), [], 0
    for (rv, transform), value in zip(transforms, values, strict=True):
        shape = model.rvs_to_values[rv].type.shape
        size = int(np.prod(shape)) if None not in shape else value.size
        own = moved[first : first + size].reshape(shape if None not in shape else value.shape)
        first = first + size
        own = own if transform is None else transform.backward(own, *rv.owner.inputs)
        result.append(pt.specify_shape(own, rv.type.shape))
    return result


def with_potential(model, likelihood) -> pm.Model:
    """A model that shares the free parameters and data of another, and has a potential for its data."""
    likelihood.name = NAME
    new = pm.Model(coords=model.coords, model=None)
    for name in SHARED:
        setattr(new, name, copy.copy(getattr(model, name)))
    for rv in model.observed_RVs:
        new.values_to_rvs.pop(new.rvs_to_values.pop(rv), None)
        new.named_vars.pop(rv.name, None)
        new.named_vars_to_dims.pop(rv.name, None)
    new.potentials.append(likelihood)
    new.named_vars[NAME] = likelihood
    return new
