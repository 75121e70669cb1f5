"""The likelihood's maximum, and how the residuals depend on the parameters there."""

from contextlib import ExitStack
from itertools import islice
from typing import NamedTuple

import numpy as np
from pymc.pytensorf import compile as compile_function

from pymc_features.calibration.comparison import Comparison, comparison
from pymc_features.calibration.coordinates import EDGE, Coordinates, sides_of
from pymc_features.calibration.gaps import check_gaps, mirrored
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
    """A point, and the likelihoods there; of a climb the maximum within the bounds of the prior.

    Attributes
    ----------
    coordinates : Coordinates
    w : array (d,)
        Flat point in these.
    events : list of Event
    height : float
        Log-likelihood, without constants.
    n_evaluations : int
        Predictions that it took.
    """

    coordinates: Coordinates
    w: np.ndarray
    events: list[Event]
    height: float = np.nan
    n_evaluations: int = 0

    @property
    def z(self) -> np.ndarray:
        """Unconstrained parameters (d,)."""
        return self.coordinates.unconstrained(self.w)

    @property
    def score(self) -> np.ndarray:
        """Gradient of the log-likelihood (d,)."""
        return sum(event.score for event in self.events)

    @property
    def information(self) -> np.ndarray:
        """Minus the Hessian (d, d), by Gauss and Newton."""
        return sum(event.information for event in self.events)

    @property
    def claimed(self) -> float:
        """Observations that the likelihoods claim."""
        return sum(float(event.claimed.sum()) for event in self.events)

    @property
    def squares(self) -> float:
        """Sum of squares of the residuals."""
        return sum(float((event.residuals**2).sum()) for event in self.events)

    @property
    def pushing(self) -> np.ndarray:
        """Score (d,) of the parameters that it pushes against a bound; zero of the others."""
        score, (low, high) = self.score, self.coordinates.limits
        at_low, at_high = self.w - low < EDGE, high - self.w < EDGE
        return np.where(at_low & (score < 0) | at_high & (score > 0), score, 0.0)

    def measured_from_bounds(self, near) -> "Fit":
        """The same point in coordinates where some parameters (d,) are measured from a bound."""
        new, z = self.coordinates.measured_from_bounds(near), self.z
        ratio = self.coordinates.slopes(z) / new.slopes(z)
        events = [
            e._replace(sensitivities=e.sensitivities * ratio, of_scale=e.of_scale * ratio)
            for e in self.events
        ]
        return self._replace(coordinates=new, w=np.clip(new.of(z), *new.limits), events=events)


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
        self.comparisons = [
            comparison(rv.owner.op, rv, model.rvs_to_values[rv])._replace(name=rv.name)
            for rv in model.observed_RVs
        ]
        check_gaps(model)
        self.modes = [modes_of(model, one.mu) for one in self.comparisons]
        tensors = model.replace_rvs_by_values([x for one in self.comparisons for x in one.tensors])
        self.function = compile_function(
            list(model.value_vars), tensors, **with_mode({"on_unused_input": "ignore"}, tensors)
        )
        self.count = 0

    def __call__(self, z) -> list[Comparison]:
        """All likelihoods at a point (d,)."""
        self.count += 1
        values = iter(self.function(*self.space.split(z).values()))
        return [one.by_sensor(*islice(values, 5)) for one in self.comparisons]

    def with_noisy_base(self, z, sd, rng) -> list[Comparison]:
        """The same with noise of a standard deviation [m/s^2] on the motion of every base."""
        with ExitStack() as stack:
            for one in self.comparisons:
                stack.enter_context(noisy_base(one.mu, sd, rng))
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


def log_likelihood(values) -> float:
    """Of all likelihoods, without constants; minus infinity where it is not finite."""
    total = sum(value.log_likelihood for value in values)
    return total if np.isfinite(total) else -np.inf


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
    events = []
    for i, value in enumerate(here):
        mu, log_scale = (
            np.stack([getattr(a[i], name) - getattr(b[i], name) for a, b in ends], axis=-1) / (up - down)
            for name in ("mu", "log_scale")
        )
        measured = ~np.isnan(value.observed)
        events.append(
            Event(
                value.name,
                value.residuals,
                value.scaled(mu),
                log_scale,
                value.claimed,
                value.mu,
                value.step,
                None if measured.all() else measured,
            )
        )
    return events


def of_base_noise(predictions, fit: Fit, sd: float) -> np.ndarray:
    """Covariance (d, d) of the score by white noise of a standard deviation [m/s^2] on the base's record.

    By `REALISATIONS` of the noise: good to 5 % of a standard deviation.
    """
    rng, scores = np.random.default_rng(0), []
    for _ in range(REALISATIONS):
        values = zip(predictions.with_noisy_base(fit.z, sd, rng), fit.events, strict=True)
        scores.append(
            sum(np.einsum("stp,st->p", e.sensitivities, v.residuals - e.residuals) for v, e in values)
        )
    return np.einsum("np,nq->pq", scores, scores) / REALISATIONS
