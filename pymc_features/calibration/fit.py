"""A likelihood at a point, and how the residuals depend on the parameters there."""

from contextlib import ExitStack
from itertools import islice
from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from pymc.pytensorf import compile as compile_function

from pymc_features.calibration.comparison import Comparison, comparisons
from pymc_features.calibration.coordinates import EDGE, Coordinates, sides_of
from pymc_features.inference.parameters import Unconstrained
from pymc_features.ops import frequencies_behind, noisy_base
from pymc_features.smc.density.compilation import with_mode


class Event(NamedTuple):
    """One likelihood at a point with derivatives by coordinates w, see `Coordinates`."""

    value: Comparison
    residuals: np.ndarray  # r (sensor, time)
    sensitivities: np.ndarray  # S = -dr / dw at constant scale (sensor, time, parameter)
    of_scale: np.ndarray  # d ln s / dw (sensor, parameter)
    frequencies: np.ndarray | None = None  # natural ones [Hz] of the structure behind it; None without one

    def whole(self, series):
        """Series (sensor, time, ...) with what stands in for them in gaps.

        In a gap of any sensor the series of all are taken in reverse order from beside it, half from before
        and half from behind: errors seen backwards have the same spectrum, amplitude and share in common.
        """
        gaps = self.value.gaps.any(axis=0)
        return series[:, mirrored(gaps)] if gaps.any() else series

    @property
    def score(self) -> np.ndarray:
        """Gradient of the log-likelihood (parameter,)."""
        excess = (self.residuals**2).sum(axis=1) - self.value.claimed
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
        value = Comparison(*(x[[j]] for x in self.value[:5]), *self.value[5:])
        return Event(value, self.residuals[[j]], self.sensitivities[[j]], 0.0 * self.of_scale[[j]])


def mirrored(gaps) -> np.ndarray:
    """For each sample (time,) itself or, in a gap, the one that stands in for it: beyond the nearer end."""
    n, at = gaps.size, np.arange(gaps.size)
    known = np.flatnonzero(~gaps)
    for first, last in np.flatnonzero(np.diff(np.r_[False, gaps, False].astype(np.int8))).reshape(-1, 2):
        for k in range(first, last):
            ends = (2 * first - 1 - k, 2 * last - 1 - k)
            if 2 * k >= first + last - 1:
                ends = ends[::-1]
            inside = [end for end in ends if 0 <= end < n and not gaps[end]]
            at[k] = inside[0] if inside else known[np.abs(known - k).argmin()]
    return at


class Fit(NamedTuple):
    """A point, and the likelihoods there; of a climb the maximum within the bounds of the prior."""

    coordinates: Coordinates
    w: np.ndarray  # (d,) in these
    events: list[Event]
    height: float = np.nan  # log-likelihood, without constants
    n_evaluations: int = 0  # predictions that it took

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
        return sum(float(event.value.claimed.sum()) for event in self.events)

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

    def measured_from_bounds(self, near) -> tuple["Fit", np.ndarray]:
        """Measure some parameters (d,) of the point from a bound; also old changes over new (d,)."""
        new, z = self.coordinates._replace(near=near & (self.coordinates.sides > 0)), self.z
        ratio = self.coordinates.slopes(z) / new.slopes(z)
        events = [
            e._replace(sensitivities=e.sensitivities * ratio, of_scale=e.of_scale * ratio)
            for e in self.events
        ]
        return self._replace(coordinates=new, w=np.clip(new.of(z), *new.limits), events=events), ratio


class Predictions:
    """Compiled predictions of all likelihoods of a model."""

    def __init__(self, model):
        self.comparisons = comparisons(model)
        self.model, self.space = model, Unconstrained(model)
        self.coordinates = Coordinates.plain(sides_of(model, self.space), self.space.join(self.space.point))
        self.modes = [modes_of(model, one.mu) for one in self.comparisons]
        tensors = [pt.as_tensor_variable(x) for one in self.comparisons for x in one[:5]]
        tensors = model.replace_rvs_by_values(tensors)
        self.function = compile_function(
            list(model.value_vars), tensors, **with_mode({"on_unused_input": "ignore"}, tensors)
        )
        self.count = 0

    def __call__(self, z) -> list[Comparison]:
        """All likelihoods at a point (d,)."""
        self.count += 1
        values = iter(self.function(*self.space.split(z).values()))
        return [Comparison(*islice(values, 5), *one[5:]).by_sensor() for one in self.comparisons]

    def with_noisy_base(self, z, sd, rng) -> list[Comparison]:
        """Predict with noise of a standard deviation [m/s^2] on the motion of every base."""
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


def events_at(predictions, w, steps, here, coordinates=None, central=True) -> list[Event]:
    """Residuals and derivatives at a point (d,), by differences over some steps (d,) to both sides or one.

    `here` are the predictions at the point. Coordinates are unconstrained parameters by default; differences
    do not leave their limits.
    """
    coordinates = coordinates or predictions.coordinates
    low, high = coordinates.limits
    up = np.minimum(w + steps, high)
    down = np.where(central | (up == w), np.maximum(w - steps, low), w)

    def moved(i, end):
        w_end = np.where(np.arange(len(w)) == i, end, w)
        return here if end == w[i] else predictions(coordinates.unconstrained(w_end))

    pairs = [zip(moved(i, up[i]), moved(i, down[i]), strict=True) for i in range(len(w))]
    events = []
    for value, *ends in zip(here, *pairs, strict=True):
        mu, log_scale = (
            np.stack([getattr(a, name) - getattr(b, name) for a, b in ends], axis=-1) / (up - down)
            for name in ("mu", "log_scale")
        )
        events.append(Event(value, value.residuals, value.scaled(mu), log_scale))
    return events
