"""The likelihood's maximum, and how the residuals depend on the parameters there."""

from contextlib import ExitStack
from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from pymc.pytensorf import compile as compile_function

from pymc_features.calibration.comparison import comparison, independent
from pymc_features.calibration.coordinates import EDGE, Coordinates, sides_of
from pymc_features.calibration.gaps import check_gaps, mirrored, without_gaps
from pymc_features.inference.parameters import Unconstrained
from pymc_features.ops import frequencies_behind, noisy_base
from pymc_features.smc.density.compilation import with_mode

REALISATIONS = 200  # of noise on a base


class Event(NamedTuple):
    """One likelihood at a point; derivatives are those by coordinates w, see `Coordinates`.

    Attributes
    ----------
    name : str
    residuals : array (sensor, time)
        r, in units of their scale; zero in gaps.
    sensitivities : array (sensor, time, parameter)
        S = -dr / dw at constant scale; zero in gaps.
    of_scale : array (sensor, parameter)
        d ln s / dw.
    claimed : array (sensor,)
        Independent observations m that the likelihood claims.
    response : array (sensor, time)
        Prediction, in the units of the data.
    step : float
        Sampling step [s].
    measured : bool array (sensor, time), optional
        Which samples were; None if all.
    frequencies : array (m,), optional
        Natural frequencies [Hz] of the structure behind the prediction; None where there is none.
    """

    name: str
    residuals: np.ndarray
    sensitivities: np.ndarray
    of_scale: np.ndarray
    claimed: np.ndarray
    response: np.ndarray
    step: float
    measured: np.ndarray | None = None
    frequencies: np.ndarray | None = None

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
    def of_response(self) -> np.ndarray:
        """Part of the information (parameter, parameter) that comes from the response: sum S S'."""
        flat = self.sensitivities.reshape(-1, self.sensitivities.shape[-1])
        return flat.T @ flat

    @property
    def information(self) -> np.ndarray:
        """Minus the Hessian (parameter, parameter), by Gauss and Newton."""
        squares = (self.residuals**2).sum(axis=1)
        return self.of_response + 2.0 * (self.of_scale.T * squares) @ self.of_scale

    def of_sensor(self, j) -> "Event":
        """What one sensor alone tells of the response."""
        names = "residuals", "sensitivities", "of_scale", "claimed", "response", "measured"
        own = {name: None if (x := getattr(self, name)) is None else x[[j]] for name in names}
        return self._replace(**own | {"of_scale": 0.0 * own["of_scale"], "frequencies": None})


class Fit(NamedTuple):
    """The maximum of the likelihood within the bounds of the prior.

    Attributes
    ----------
    coordinates : Coordinates
    w : array (d,)
        Flat point in these.
    events : list of Event
    n_evaluations : int
        Predictions that it took.
    """

    coordinates: Coordinates
    w: np.ndarray
    events: list[Event]
    n_evaluations: int

    @property
    def z(self) -> np.ndarray:
        """Unconstrained parameters (d,)."""
        return self.coordinates.unconstrained(self.w)

    @property
    def information(self) -> np.ndarray:
        """Of all events (d, d)."""
        return information_of(self.events)

    @property
    def pushing(self) -> np.ndarray:
        """Score (d,) of the parameters that it pushes against a bound; zero of the others."""
        score, (low, high) = score_of(self.events), self.coordinates.limits
        at_low, at_high = self.w - low < EDGE, high - self.w < EDGE
        return np.where(at_low & (score < 0) | at_high & (score > 0), score, 0.0)

    def measured_from_bounds(self, near) -> "Fit":
        """The same point in coordinates where some parameters (d,) are measured from a bound."""
        z, old = self.z, self.coordinates
        new = old._replace(near=near & (old.sides > 0))
        ratio = old.slopes(z) / new.slopes(z)
        events = [
            e._replace(sensitivities=e.sensitivities * ratio, of_scale=e.of_scale * ratio)
            for e in self.events
        ]
        return Fit(new, np.clip(new.of(z), *new.limits), events, self.n_evaluations)


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
        self.coordinates = Coordinates.plain(sides_of(model), self.space.join(self.space.point))
        self.names = [rv.name for rv in model.observed_RVs]
        parts = [comparison(rv.owner.op, rv, model.rvs_to_values[rv]) for rv in model.observed_RVs]
        check_gaps(model)
        self.steps = [part.step for part in parts]
        self.responses = [part.mu for part in parts]
        self.modes = [modes_of(model, mu) for mu in self.responses]
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

    def with_noisy_base(self, z, sd, rng) -> list[list[np.ndarray]]:
        """Values at a point (d,), with noise of a standard deviation [m/s^2] on the motion of every base."""
        with ExitStack() as stack:
            for mu in self.responses:
                stack.enter_context(noisy_base(mu, sd, rng))
            return self(z)

    def frequencies(self, z) -> list:
        """Natural frequencies (m,) [Hz] of each likelihood's structure, None where there is none."""
        return [None if of is None else of(self.space.split(z)) for of in self.modes]


def modes_of(model, mu):
    """Natural frequencies (m,) [Hz] of the structure behind a prediction, of a point; None without one."""
    if (behind := frequencies_behind(mu)) is None:
        return None
    inputs, of_values = behind
    compiled = {"mode": "FAST_COMPILE", "on_unused_input": "ignore"}
    function = model.compile_fn(model.replace_rvs_by_values(inputs), inputs=model.value_vars, **compiled)
    return lambda point: of_values(function(point))


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


def events_at(predictions, w, steps, here, coordinates=None, central=True) -> list[Event]:
    """Residuals and derivatives at a point (d,), by differences over some steps (d,) to both sides or one.

    `here` are the predictions at the point. Coordinates are unconstrained parameters by default; differences
    do not leave their limits.
    """
    coordinates = coordinates or predictions.coordinates
    low, high = coordinates.limits
    up = np.minimum(w + steps, high)
    down = np.where(central | (up == w), np.maximum(w - steps, low), w)
    ends = [
        [
            here if end == w[i] else predictions(coordinates.unconstrained(np.where(axis, end, w)))
            for end in (up[i], down[i])
        ]
        for i, axis in enumerate(np.eye(len(w), dtype=bool))
    ]
    return from_differences(predictions, here, ends, up - down)


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


def score_of(events):
    """Gradient of the log-likelihood (d,) of all events."""
    return sum(event.score for event in events)


def information_of(events):
    """Minus the Hessian (d, d) of the log-likelihood of all events, by Gauss and Newton."""
    return sum(event.information for event in events)


def of_base_noise(predictions, fit: Fit, sd: float) -> np.ndarray:
    """Covariance (d, d) of the score by white noise of a standard deviation [m/s^2] on the base's record.

    By `REALISATIONS` of the noise: good to 5 % of a standard deviation.
    """
    rng, scores = np.random.default_rng(0), []
    for _ in range(REALISATIONS):
        values = predictions.with_noisy_base(fit.z, sd, rng)
        off = [residuals_of(value) - event.residuals for value, event in zip(values, fit.events, strict=True)]
        scores.append(
            sum(np.einsum("stp,st->p", e.sensitivities, x) for e, x in zip(fit.events, off, strict=True))
        )
    return np.einsum("np,nq->pq", scores, scores) / REALISATIONS
