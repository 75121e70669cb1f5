"""The likelihood's maximum, and how the residuals depend on the parameters there."""

from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from pymc.pytensorf import compile as compile_function

from pymc_features.calibration.comparison import comparison, independent
from pymc_features.calibration.gaps import check_gaps, mirrored, without_gaps
from pymc_features.inference.parameters import Unconstrained
from pymc_features.smc.density.compilation import with_mode


class Event(NamedTuple):
    """One likelihood at a point; derivatives are those by the unconstrained parameters.

    Attributes
    ----------
    name : str
    residuals : array (sensor, time)
        r, in units of their scale; zero in gaps.
    sensitivities : array (sensor, time, parameter)
        S = -dr / dz at constant scale; zero in gaps.
    of_scale : array (sensor, parameter)
        d ln s / dz.
    claimed : array (sensor,)
        Independent observations m that the likelihood claims.
    response : array (sensor, time)
        Prediction, in the units of the data.
    step : float
        Sampling step [s].
    measured : bool array (sensor, time), optional
        Which samples were; None if all.
    """

    name: str
    residuals: np.ndarray
    sensitivities: np.ndarray
    of_scale: np.ndarray
    claimed: np.ndarray
    response: np.ndarray
    step: float
    measured: np.ndarray | None = None

    @property
    def n_samples(self) -> int:
        """Samples that were measured."""
        return self.residuals.size if self.measured is None else int(self.measured.sum())

    def whole(self, series):
        """Series (sensor, time, ...) with what stands in for them in gaps."""
        return series if self.measured is None else series[:, mirrored(~self.measured.all(axis=0))]

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
        return information_of(self.events)


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
        check_gaps(model)
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
    return independent(without_gaps((observed - mu) / scale, observed), decay)


def events_at(predictions, z, steps, here, sides=(1.0, -1.0)) -> list[Event]:
    """Residuals and derivatives at a point (d,), by differences over some steps (d,) to one side or both.

    `here` are the predictions at the point.
    """
    ends = [
        [predictions(z + side * step * axis) for side in sides]
        for step, axis in zip(steps, np.eye(len(z)), strict=True)
    ]
    ends = [[*end, here][:2] for end in ends]
    return from_differences(predictions, here, ends, len(sides) * steps)


def from_differences(predictions, here, ends, widths) -> list[Event]:
    """Events with derivatives from predictions at both ends of an interval for each parameter."""
    events = []
    for i, (name, step) in enumerate(zip(predictions.names, predictions.steps, strict=True)):
        observed, scale, decay = here[i][1], here[i][2], here[i][5]
        measured = ~np.isnan(observed)
        slopes = [
            independent(without_gaps((up[i][0] - down[i][0]) / (h * scale), observed), decay)
            for (up, down), h in zip(ends, widths, strict=True)
        ]
        of_scale = [(up[i][3] - down[i][3]) / h for (up, down), h in zip(ends, widths, strict=True)]
        events.append(
            Event(
                name,
                residuals_of(here[i]),
                np.stack(slopes, axis=-1),
                np.stack(of_scale, axis=-1),
                here[i][4],
                here[i][0],
                step,
                None if measured.all() else measured,
            )
        )
    return events


def information_of(events):
    """Minus the Hessian (d, d) of the log-likelihood of all events, by Gauss and Newton."""
    return sum(event.information for event in events)


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
