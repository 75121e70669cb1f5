"""The likelihood's maximum, and how the residuals depend on the parameters there."""

from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from pymc.pytensorf import compile as compile_function

from pymc_features.calibration.comparison import comparison, independent
from pymc_features.calibration.sandwich import whitening
from pymc_features.inference.parameters import Unconstrained
from pymc_features.smc.density.compilation import with_mode

DIFFERENCE = 0.02  # standard errors of independent samples that derivatives are taken over,
WIDEST, NARROWEST = 1e-3, 1e-7  # but no more and no less than this, on the unconstrained scale
NARROW = 1e-5  # before standard errors are known
STEPS = 100  # towards the maximum, at most
CONVERGED = 1e-3  # of a standard error of independent samples that the last step may be long
LEAST = 0.1  # of the information that the curvature is taken to have where it is less, or negative
LONGEST = 1.0  # step, on the unconstrained scale
SINGULAR = 1e-12  # of the largest relative eigenvalue: directions that change nothing


class Event(NamedTuple):
    """One likelihood at a point; derivatives are those by the unconstrained parameters.

    Attributes
    ----------
    name : str
    residuals : array (sensor, time)
        r, in units of their scale.
    sensitivities : array (sensor, time, parameter)
        S = -dr / dz at constant scale.
    of_scale : array (sensor, parameter)
        d ln s / dz.
    claimed : array (sensor,)
        Independent observations m that the likelihood claims.
    response : array (sensor, time)
        Prediction, in the units of the data.
    step : float
        Sampling step [s].
    """

    name: str
    residuals: np.ndarray
    sensitivities: np.ndarray
    of_scale: np.ndarray
    claimed: np.ndarray
    response: np.ndarray
    step: float

    @property
    def score(self) -> np.ndarray:
        """Gradient of the log-likelihood (parameter,)."""
        excess = (self.residuals**2).sum(axis=1) - self.claimed
        return np.einsum("stp,st->p", self.sensitivities, self.residuals) + excess @ self.of_scale

    @property
    def information(self) -> np.ndarray:
        """Minus its Hessian (parameter, parameter), by Gauss and Newton."""
        flat = self.sensitivities.reshape(-1, self.sensitivities.shape[-1])
        squares = (self.residuals**2).sum(axis=1)
        return flat.T @ flat + 2.0 * (self.of_scale.T * squares) @ self.of_scale


class Fit(NamedTuple):
    """The maximum of the likelihood.

    Attributes
    ----------
    z : array (d,)
        Unconstrained parameters, flat.
    events : list of Event
    n_evaluations : int
        Predictions that it took.
    """

    z: np.ndarray
    events: list[Event]
    n_evaluations: int

    @property
    def information(self) -> np.ndarray:
        """Of all events (d, d)."""
        return sum(event.information for event in self.events)


class Predictions:
    """Compiled predictions of all likelihoods of a model.

    Parameters
    ----------
    model : pymc.Model
    """

    def __init__(self, model):
        if not model.observed_RVs:
            raise ValueError("`model` must have observed variables, got none.")
        self.model, self.space = model, Unconstrained(model)
        self.names = [rv.name for rv in model.observed_RVs]
        parts = [comparison(rv.owner.op, rv, model.rvs_to_values[rv]) for rv in model.observed_RVs]
        self.steps = [part.step for part in parts]
        tensors = [pt.as_tensor_variable(x) for part in parts for x in part.tensors]
        tensors = model.replace_rvs_by_values(tensors)
        self.function = compile_function(
            list(model.value_vars), tensors, **with_mode({"on_unused_input": "ignore"}, tensors)
        )
        self.count = 0

    def __call__(self, z) -> list[list[np.ndarray]]:
        """Values at a point (d,): mu, observed, scale, ln s, claimed, decay of each likelihood."""
        self.count += 1
        flat = self.function(*self.space.split(z).values())
        return [by_sensor(*flat[i : i + 6]) for i in range(0, len(flat), 6)]


def by_sensor(mu, observed, scale, log_scale, claimed, decay):
    """The same with one axis of sensors."""
    n_times = mu.shape[-1] if mu.ndim else 1
    histories = [np.reshape(x, (-1, n_times)) for x in (mu, observed, scale)]
    return histories + [np.reshape(x, -1).astype(np.float64) for x in (log_scale, claimed, decay)]


def log_likelihood(values) -> float:
    """Of all likelihoods, without constants."""
    total = 0.0
    for value in values:
        total -= 0.5 * np.sum(residuals_of(value) ** 2) + value[4] @ value[3]
    return total if np.isfinite(total) else -np.inf


def residuals_of(value):
    """Scaled residuals (sensor, time), independent under the likelihood."""
    mu, observed, scale, _, _, decay = value
    return independent((observed - mu) / scale, decay)


def events_at(predictions, z, steps) -> list[Event]:
    """Residuals and derivatives at a point (d,), by central differences of some steps (d,)."""
    here = predictions(z)
    moved = [
        [predictions(z + sign * step * axis) for sign in (1.0, -1.0)]
        for step, axis in zip(steps, np.eye(len(z)), strict=True)
    ]
    events = []
    for i, (name, step) in enumerate(zip(predictions.names, predictions.steps, strict=True)):
        scale, decay = here[i][2], here[i][5]
        slopes = [
            independent((up[i][0] - down[i][0]) / (2.0 * h * scale), decay)
            for (up, down), h in zip(moved, steps, strict=True)
        ]
        of_scale = [(up[i][3] - down[i][3]) / (2.0 * h) for (up, down), h in zip(moved, steps, strict=True)]
        events.append(
            Event(
                name,
                residuals_of(here[i]),
                np.stack(slopes, axis=-1),
                np.stack(of_scale, axis=-1),
                here[i][4],
                here[i][0],
                step,
            )
        )
    return events


def climb_likelihood(predictions, z) -> Fit:
    """The maximum of the likelihood near a point (d,), by Levenberg's and Marquardt's method.

    Where residuals are large their second derivatives count; these are learnt from one step to the next.
    """
    start = predictions.count
    value, damping = log_likelihood(predictions(z)), 1e-6
    if value == -np.inf:
        raise ValueError("the fit must start where the likelihood is finite. Pass another `idata`.")
    events = events_at(predictions, z, np.full(len(z), NARROW))
    events = events_at(predictions, z, differences(events))
    score, second = score_of(events), np.zeros((len(z), len(z)))
    for _ in range(STEPS):
        information = sum(event.information for event in events)
        step = newton(curvature(information, second), score, damping)
        if np.sqrt(excess(events) * max(0.0, step @ information @ step)) < CONVERGED:
            break
        values = predictions(z + step)
        new = log_likelihood(values)
        if not new > value:
            damping = max(damping, 1e-6) * 10.0
            continue
        z, value, damping = z + step, new, damping / 10.0
        stale = score_of(with_residuals(events, values))
        events, before = events_at(predictions, z, differences(events)), score
        score = score_of(events)
        second = learnt(second, step, stale - score, before - score)
    return Fit(z, events, predictions.count - start)


def score_of(events):
    """Gradient of the log-likelihood (d,) of all events."""
    return sum(event.score for event in events)


def learnt(second, step, change, total):
    """What second derivatives add to the information (d, d), after a step (d,) that it changed by `change`.

    `total` is the change of the whole score (Dennis, Gay & Welsch, ACM Trans. Math. Softw. 7, 1981).
    """
    along, known = total @ step, step @ second @ step
    if not along > 0:
        return second
    size = min(1.0, abs(step @ change / known)) if known else 1.0
    off = change - size * (second @ step)
    cross = np.outer(off, total) / along
    return size * second + cross + cross.T - (off @ step) / along**2 * np.outer(total, total)


def curvature(information, second):
    """Their sum (d, d), but at least a part of the information in every direction."""
    whiten = whitening(information)
    unwhiten = whiten.T @ information
    relative = whiten.T @ second @ whiten
    values, vectors = np.linalg.eigh(0.5 * (relative + relative.T))
    along = (vectors * np.maximum(values, LEAST - 1.0)) @ vectors.T
    return information + unwhiten.T @ along @ unwhiten


def hessian(predictions, z, axes) -> np.ndarray:
    """Minus the second derivatives (k, k) of the log-likelihood at a point (d,) along axes (k, d).

    By differences over the length of the axes, and by this length.
    """

    def value(x):
        return log_likelihood(predictions(x))

    here = value(z)
    sides = np.array([[value(z + sign * axis) for sign in (1.0, -1.0)] for axis in axes])
    result = np.diag(2.0 * here - sides.sum(axis=1))
    for i in range(len(axes)):
        for j in range(i):
            both = value(z + axes[i] + axes[j]) + value(z - axes[i] - axes[j])
            result[i, j] = result[j, i] = 0.5 * (sides[i].sum() + sides[j].sum() - both) - here
    return result


def with_residuals(events, values):
    """The events with the residuals at another point, and the derivatives they had."""
    return [
        event._replace(residuals=residuals_of(value), claimed=value[4], response=value[0])
        for event, value in zip(events, values, strict=True)
    ]


def excess(events):
    """Samples over the observations that the likelihood claims."""
    return sum(event.residuals.size for event in events) / sum(event.claimed.sum() for event in events)


def differences(events):
    """Steps (d,) of central differences, a part of the standard errors of independent samples."""
    information = sum(event.information for event in events)
    scale = np.sqrt(excess(events) * np.diag(information)).clip(min=np.finfo(float).tiny)
    return np.clip(DIFFERENCE / scale, NARROWEST, WIDEST)


def newton(information, score, damping):
    """A damped Newton step (d,), none along directions that change nothing."""
    scale = np.sqrt(np.diag(information))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    known = values > SINGULAR * values.max(initial=0.0)
    along = vectors.T @ (score / scale)
    step = vectors @ np.where(known, along / np.where(known, values + damping, 1.0), 0.0) / scale
    return step / max(1.0, np.abs(step).max() / LONGEST)
