"""A model whose likelihood is stretched around its maximum, so that its curvature is another.

    ln L_cal(w) = power ln L(w_hat + C (w - w_hat)),

on the unconstrained scale, where every point is possible (Ribatet, Cooley & Davison, Stat. Sin. 22, 2012).
The prior is not touched: its bounds and its information keep their meaning.

Parameters b near a bound are measured from it (`Coordinates`). With d = w - w_hat, P = A B^-1 A, h = A B^-1 g
and g the score that pushes against the bounds, ln L_cal is meant to be h'd - d'P d / 2, exponential at a
bound and normal away from it. Of that the part of d_b alone is taken as it is, s'd_b - d_b' Q d_b / 2, and
that of the others given d_b is the stretched likelihood at the maximum's w_b:

    ln L_cal = s'd_b - d_b' Q d_b / 2 + power ln L(w_hat_b, w_hat_f + C (d_f - m(d_b))),

with m(d_b) = P_ff^-1 (h_f - P_fb d_b). No likelihood is evaluated outside the prior.
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
FARTHEST = 1e4  # from the maximum: unconstrained values that rounding has made infinite are there
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
    if not whiten.size:
        return 1.0, np.eye(len(information))
    unwhiten = whiten.T @ information  # its inverse from the left
    relative = whiten.T @ precision @ whiten
    values, vectors = np.linalg.eigh(0.5 * (relative + relative.T))
    power = float(np.exp(np.mean(np.log(values))))
    along = (vectors * np.sqrt(values / power)) @ vectors.T
    return power, np.eye(len(information)) + whiten @ (along - np.eye(len(values))) @ unwhiten


class Shape(NamedTuple):
    """What a stretched likelihood is around one maximum.

    Attributes
    ----------
    power : float
        k of the likelihood.
    point : array (d,)
        w_hat.
    origin : array (d,)
        Where the likelihood is evaluated for w = w_hat.
    matrix : array (d, d)
        By which this moves with w; zero rows for parameters near a bound.
    slope, bend : array (d,), (d, d)
        s and Q of parameters near a bound; zero for others.
    """

    power: float
    point: np.ndarray
    origin: np.ndarray
    matrix: np.ndarray
    slope: np.ndarray
    bend: np.ndarray


def shape_of(fit, result) -> Shape:
    """The shape that gives a fit's likelihood the curvature of its sandwich."""
    d, near, wanted, pushed = len(fit.w), fit.coordinates.near, result.precision, result.weighed(fit.pushing)
    f, b = np.flatnonzero(~near), np.flatnonzero(near)
    power, stretch = stretching(result.information[np.ix_(f, f)], wanted[np.ix_(f, f)])
    whiten = whitening(wanted[np.ix_(f, f)])
    shift, follow = (-whiten @ whiten.T @ x for x in (-pushed[f], wanted[np.ix_(f, b)]))
    origin, matrix, slope, bend = fit.w.copy(), np.zeros((d, d)), np.zeros(d), np.zeros((d, d))
    origin[f] -= stretch @ shift
    matrix[np.ix_(f, f)], matrix[np.ix_(f, b)] = stretch, -stretch @ follow
    slope[b] = pushed[b] + follow.T @ pushed[f]
    bend[np.ix_(b, b)] = wanted[np.ix_(b, b)] + wanted[np.ix_(b, f)] @ follow
    return Shape(power, fit.w, origin, matrix, slope, bend)


class Adjusted(NamedTuple):
    """A model with a stretched likelihood, and its shared variables: other values are no other code.

    Attributes
    ----------
    model : pymc.Model
    shape : list of SharedVariable
        Those of a `Shape`.
    precision : SharedVariable (d, d)
        Of the calibrated likelihood.
    others, other_precisions : SharedVariable (mode, d), (mode, d, d)
        Maxima that are calibrated by themselves. What is nearer to one of them has no likelihood here.
    """

    model: pm.Model
    shape: list
    precision: pytensor.compile.SharedVariable
    others: pytensor.compile.SharedVariable
    other_precisions: pytensor.compile.SharedVariable

    def set(self, shape: Shape, *values):
        """Give all shared variables values, in their order."""
        for shared, value in zip([*self.shape, *self[2:]], [*shape, *values], strict=True):
            shared.set_value(np.asarray(value, dtype=np.float64))


def adjusted_model(model: pm.Model, coordinates, n_modes: int = 1) -> Adjusted:
    """The model with the free parameters and priors of another, and its likelihood as a potential.

    Points are flat, in the order of the model's value variables.
    """
    d = len(coordinates.near)
    shapes = (), (d,), (d,), (d, d), (d,), (d, d), (d, d), (n_modes - 1, d), (n_modes - 1, d, d)
    shared = [pytensor.shared(np.zeros(shape)) for shape in shapes]
    adjusted = Adjusted(model, shared[:6], *shared[6:])
    power, point, origin, matrix, slope, bend = adjusted.shape
    stand_ins = {rv: rv.type(name=rv.name) for rv in model.free_RVs}
    terms = [pm.logp(rv, model.rvs_to_values[rv]).sum() for rv in model.observed_RVs]
    terms = graph_replace(terms, stand_ins, strict=False)
    w = measured(coordinates, flattened(model))
    off = pt.clip(w - point, -FARTHEST, FARTHEST)
    moved = unmeasured(coordinates, origin + pt.dot(matrix, off))
    moved = dict(zip(stand_ins.values(), separated(model, moved), strict=True))
    likelihood = power * pt.add(*graph_replace(terms, moved, strict=False), 0.0)
    if coordinates.near.any():
        likelihood += pt.dot(slope, off) - 0.5 * pt.dot(off, pt.dot(bend, off))
    if n_modes > 1:
        likelihood = pt.switch(is_nearest(adjusted, off, w), likelihood, -np.inf)
    return adjusted._replace(model=with_potential(model, likelihood))


def measured(coordinates, flat):
    """Coordinates (d,) of an unconstrained point; a variable."""
    one, two = (coordinates.near & (coordinates.sides == n) for n in (1, 2))
    if not (one | two).any():
        return flat
    own = pt.switch(two, pt.sigmoid(flat), pt.exp(pt.switch(one, flat - coordinates.origin, 0.0)))
    return pt.switch(one | two, own, flat)


def unmeasured(coordinates, w):
    """The unconstrained point (d,) of coordinates; a variable."""
    one, two = (coordinates.near & (coordinates.sides == n) for n in (1, 2))
    if not (one | two).any():
        return w
    rest = pt.log1p(-pt.switch(two, w, 0.0))
    own = pt.log(pt.switch(one | two, w, 1.0)) + coordinates.origin - rest
    return pt.switch(one | two, own, w)


def is_nearest(adjusted, own, w):
    """Whether no other maximum is nearer to a point, in standard deviations."""
    apart = w - adjusted.others
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
