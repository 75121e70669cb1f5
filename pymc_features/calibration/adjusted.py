"""A model whose likelihood is stretched around its maximum, so that its curvature is another.

    ln L_cal(z) = power ln L(z_hat + C (z - z_hat)),

on the unconstrained scale, where every point is possible (Ribatet, Cooley & Davison, Stat. Sin. 22, 2012).
The prior is not touched: its bounds and its information keep their meaning.
"""

import copy
from typing import NamedTuple

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


class Adjusted(NamedTuple):
    """A model with a stretched likelihood, and its shared variables: other values are no other code.

    Attributes
    ----------
    model : pymc.Model
    power, point, matrix : SharedVariable
        k, z_hat (d,) and C (d, d).
    precision : SharedVariable (d, d)
        Of the calibrated likelihood.
    others, other_precisions : SharedVariable (mode, d), (mode, d, d)
        Maxima that are calibrated by themselves. What is nearer to one of them has no likelihood here.
    """

    model: pm.Model
    power: pytensor.compile.SharedVariable
    point: pytensor.compile.SharedVariable
    matrix: pytensor.compile.SharedVariable
    precision: pytensor.compile.SharedVariable
    others: pytensor.compile.SharedVariable
    other_precisions: pytensor.compile.SharedVariable

    def set(self, *values):
        """Give all shared variables values, in their order."""
        for shared, value in zip(self[1:], values, strict=True):
            shared.set_value(np.asarray(value, dtype=np.float64))


def adjusted_model(model: pm.Model, n_modes: int = 1) -> Adjusted:
    """The model with the free parameters and priors of another, and its likelihood as a potential.

    Points are flat and unconstrained, in the order of the model's value variables.
    """
    d = sum(np.size(value) for value in model.initial_point().values())
    shapes = (), (d,), (d, d), (d, d), (n_modes - 1, d), (n_modes - 1, d, d)
    shared = [pytensor.shared(np.zeros(shape)) for shape in shapes]
    adjusted = Adjusted(model, *shared)
    stand_ins = {rv: rv.type(name=rv.name) for rv in model.free_RVs}
    terms = [pm.logp(rv, model.rvs_to_values[rv]).sum() for rv in model.observed_RVs]
    terms = graph_replace(terms, stand_ins, strict=False)
    flat = flattened(model)
    moved = adjusted.point + pt.dot(adjusted.matrix, flat - adjusted.point)
    moved = dict(zip(stand_ins.values(), separated(model, moved), strict=True))
    likelihood = adjusted.power * pt.add(*graph_replace(terms, moved, strict=False), 0.0)
    if n_modes > 1:
        likelihood = pt.switch(is_nearest(adjusted, flat), likelihood, -np.inf)
    return adjusted._replace(model=with_potential(model, likelihood))


def is_nearest(adjusted, flat):
    """Whether no other maximum is nearer to a point, in standard deviations."""
    own, apart = flat - adjusted.point, flat - adjusted.others
    distance = pt.dot(own, pt.dot(adjusted.precision, own))
    others = (apart[:, None] * adjusted.other_precisions * apart[:, :, None]).sum(axis=(1, 2))
    return pt.le(distance, others.min())


def flattened(model):
    """Free parameters, unconstrained and flat (d,), as a function of those of the model."""
    transforms = [(rv, model.rvs_to_transforms[rv]) for rv in model.free_RVs]
    values = [rv if t is None else t.forward(rv, *rv.owner.inputs) for rv, t in transforms]
    return pt.concatenate([value.ravel() for value in values])


def separated(model, flat) -> list:
    """Free parameters on their own scale, of a flat and unconstrained point (d,)."""
    result, first, point = [], 0, model.initial_point()
    for rv in model.free_RVs:
        shape, transform = np.shape(point[model.rvs_to_values[rv].name]), model.rvs_to_transforms[rv]
        size = int(np.prod(shape))
        own = flat[first : first + size].reshape(shape)
        own = own if transform is None else transform.backward(own, *rv.owner.inputs)
        result.append(pt.specify_shape(own, rv.type.shape))
        first += size
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
