"""What each likelihood compares, a prediction with its data, and how that depends on the parameters.

Every likelihood here is, up to a constant, a sum over its sensors of

    ln L_j = -1/2 sum_k r_jk^2 - m_j ln s_j,

with residuals r scaled by s_j, and m_j the number of independent observations that it claims of a sensor: the
number of samples under NORM, 1 under TN, 2 under EXP. Errors with a known correlation are whitened first.
Gaps in the data are NaN; residuals and sensitivities are zero there.
"""

from contextlib import ExitStack
from functools import singledispatch
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
import pytensor.tensor as pt
from pymc.distributions import transforms
from pymc.pytensorf import compile as compile_function
from pytensor.graph.basic import Constant
from pytensor.tensor.random.basic import NormalRV
from scipy.special import expit, logit

from pymc_features.inference.parameters import Unconstrained
from pymc_features.likelihoods.correlated import CorrelatedNormalRV
from pymc_features.likelihoods.mean_square import FeatureRV
from pymc_features.ops import frequencies_behind, measured_samples, noisy_base, response_step
from pymc_features.ops.declared import IN_PYTHON
from pymc_features.smc.density.rows import with_mode

MOST = 0.4  # share of the record in gaps of one sensor or another; of more the intervals become too narrow
EDGE = 1e-9  # of the distance between bounds: as near to a bound as a climb gets
LARGEST = 700.0  # logarithm of a number
ENDS = {transforms.log: (0.0, np.inf), transforms.logodds: (0.0, 1.0)}
PLAINLY = {"mode": "FAST_COMPILE", "on_unused_input": "ignore"}


class Comparison(NamedTuple):
    """One likelihood: tensors that can be broadcast, or arrays at a point, see `by_sensor`.

    There also its derivatives by coordinates w, see `Coordinates`, where they have been taken.
    """

    mu: Any  # prediction (..., time)
    observed: Any  # data (..., time)
    scale: Any  # of the residuals (observed - mu) / scale (..., time), or (..., 1) where constant in time
    claimed: Any  # m (...,) of each sensor
    decay: Any = np.inf  # sampling step over correlation time (...,); infinite for independent errors
    step: float = np.nan  # of the samples [s]; NaN if it is not known
    name: str = "y"  # of the random variable
    sensitivities: Any = None  # S = -dr / dw at constant scale (sensor, time, parameter)
    of_scale: Any = None  # d ln s / dw (sensor, parameter)
    frequencies: Any = None  # natural ones [Hz] of the structure behind it; None without one

    def by_sensor(self) -> "Comparison":
        """Turn arrays into ones with one axis of sensors."""
        mu, observed, scale, claimed, decay, *known = self
        shape = *sensors, n = observed.shape
        series = (np.broadcast_to(x, shape).reshape(-1, n) for x in (mu, observed, scale))
        numbers = (np.broadcast_to(x, sensors).ravel().astype(np.float64) for x in (claimed, decay))
        return Comparison(*series, *numbers, *known)

    @property
    def gaps(self) -> np.ndarray:
        """Samples (sensor, time) that were not measured."""
        return np.isnan(self.observed)

    def scaled(self, x) -> np.ndarray:
        """Histories (sensor, time, ...) in units of the scale, zero in gaps, without a known correlation."""
        along = (..., *[None] * (x.ndim - 2))
        x, gaps = x / self.scale[along], self.gaps
        x = np.where(gaps[along], 0.0, x) if gaps.any() else x
        if np.isinf(self.decay).all():
            return x
        decay = self.decay[:, None][along]
        rest = (x[:, 1:] - np.exp(-decay) * x[:, :-1]) / np.sqrt(-np.expm1(-2.0 * decay))
        return np.concatenate([x[:, :1], rest], axis=1)

    @property
    def residuals(self) -> np.ndarray:
        """r (sensor, time), independent under the likelihood."""
        return self.scaled(self.observed - self.mu)

    @property
    def log_scale(self) -> np.ndarray:
        """ln s (sensor,)."""
        return np.log(self.scale).mean(axis=-1)

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

    def of_sensor(self, j) -> "Comparison":
        """What one sensor alone tells of the response."""
        some, s = (x[[j]] for x in self[:5]), self.sensitivities[[j]]
        return Comparison(*some, self.step, self.name, s, 0.0 * self.of_scale[[j]])


def log_likelihood(values: list[Comparison]) -> float:
    """Sum all log-likelihoods, without constants; minus infinity where that is not finite."""
    total = sum(-0.5 * np.sum(v.residuals**2) - v.claimed @ v.log_scale for v in values)
    return total if np.isfinite(total) else -np.inf


@singledispatch
def comparison(op, rv, observed) -> Comparison:
    """Describe a likelihood. Register a distribution's Op to make `effective_samples` know it."""
    raise TypeError(
        "`model` must have Normal, CorrelatedNormal or feature likelihoods, got "
        f"{type(op).__name__} ({rv.name}). Register it with pymc_features.calibration.residuals.comparison."
    )


@comparison.register(NormalRV)
def comparison_normal(op, rv, observed):
    """Every sample an independent observation."""
    mu, sigma = op.dist_params(rv.owner)
    return Comparison(mu, observed, sigma, observed.shape[-1])


@comparison.register(FeatureRV)
def comparison_feature(op, rv, observed):
    """Take as many observations as there are degrees of freedom, each sample a part of them."""
    _, _, mu, sigma, *m = rv.owner.inputs
    n_measured = measured_samples(observed)
    root = pt.sqrt(pt.cast(observed.shape[-1], "float64") if n_measured is None else n_measured)
    return Comparison(mu, observed, pt.as_tensor_variable(sigma * root)[..., None], op.degrees(*m))


@comparison.register(CorrelatedNormalRV)
def comparison_correlated(op, rv, observed):
    """Every sample an observation, once the correlation that the likelihood assumes is taken away."""
    _, _, mu, sigma, correlation_time, dt = rv.owner.inputs
    step = float(dt.data) if isinstance(dt, Constant) else np.nan
    return Comparison(mu, observed, sigma[..., None], observed.shape[-1], dt / correlation_time, step)


def comparisons(model) -> list[Comparison]:
    """All likelihoods of a model, with the step of the response as it is now, NaN of what is none."""
    if not model.observed_RVs:
        raise ValueError("`model` must have observed variables, got none.")
    found = []
    for rv in model.observed_RVs:
        data = model.rvs_to_values[rv]
        one = comparison(rv.owner.op, rv, data)._replace(name=rv.name)
        if np.isnan(one.step):
            one = one._replace(step=response_step(one.mu, at_present=True) or np.nan)
        gaps = np.isnan(data.eval(mode=IN_PYTHON))
        if gaps.any() and not isinstance(rv.owner.op, FeatureRV):
            raise ValueError(
                f"`model` must have data without gaps, got NaN in {rv.name}. Leave them out by a feature "
                "likelihood, or compare a part of the record without gaps."
            )
        share = gaps.reshape(-1, gaps.shape[-1]).any(axis=0).mean()
        if share > MOST:
            raise ValueError(
                f"`model` must have all sensors for {100 * (1 - MOST):.0f} % of the record or more, so that "
                f"residuals tell how errors persist, got {100 * (1 - share):.0f} % in {rv.name}. Compare a "
                "part with fewer gaps, or leave out the sensor that has most of them."
            )
        found.append(one)
    return found


class Coordinates(NamedTuple):
    """Points w (..., d) for unconstrained ones z (..., d): the same, but near a bound the distance to it.

    On the scale that PyMC samples a bound is at infinity, and so is the maximum of a likelihood that wants a
    parameter beyond it. Such a parameter is measured by w = expit(z) between two bounds, from the lower one
    and over the distance between them, and by w = exp(z - origin) from its only bound.
    """

    sides: np.ndarray  # bounds (d,) of each parameter: 0, 1 or 2
    near: np.ndarray  # whether it is measured from a bound (d,)
    origin: np.ndarray  # z (d,) where the distance from an only bound is one: of the model's initial point

    def of(self, z) -> np.ndarray:
        """Coordinates of an unconstrained point."""
        one = np.where(self.sides == 1, np.minimum(z - self.origin, LARGEST), 0.0)
        return np.where(self.near, np.where(self.sides == 2, expit(z), np.exp(one)), z)

    def unconstrained(self, w) -> np.ndarray:
        """The unconstrained point of coordinates."""
        inside = np.where(self.near, w, 0.5)
        return np.where(self.near, np.where(self.sides == 2, logit(inside), np.log(inside) + self.origin), w)

    def slopes(self, z) -> np.ndarray:
        """Derivatives of the coordinates by z."""
        return np.where(self.near, self.of(z) * np.where(self.sides == 2, expit(-z), 1.0), 1.0)

    def rooms(self, z) -> np.ndarray:
        """How far w is from the lower or only bound and from the upper one (2, d), as it changes there."""
        own = self._replace(near=self.sides > 0)
        rooms = np.stack([own.of(z), np.where(self.sides == 2, expit(-z), np.inf)])
        return rooms * self.slopes(z) / own.slopes(z)

    @property
    def limits(self) -> np.ndarray:
        """Lowest and highest coordinates (2, d)."""
        high = np.where(self.sides == 2, 1.0 - EDGE, np.inf)
        return np.where(self.near, [np.full(len(high), EDGE), high], [[-np.inf], [np.inf]])


def bounds_of(model, space):
    """Compiled lower and upper bounds (2, d) of all priors, infinite where there is none."""
    found = []
    for rv in model.free_RVs:
        transform, shape = model.rvs_to_transforms[rv], space.shapes[model.rvs_to_values[rv].name]
        pair = ENDS.get(transform, (None, None))
        if isinstance(transform, transforms.Interval):
            pair = transform.args_fn(*rv.owner.inputs)
        pair = [end if x is None else x for x, end in zip(pair, (-np.inf, np.inf), strict=True)]
        found.append(pt.stack([pt.broadcast_to(x, shape).ravel() for x in pair]))
    [bounds] = model.replace_rvs_by_values([pt.concatenate(found, axis=1)])
    return model.compile_fn(bounds, inputs=model.value_vars, **PLAINLY)


class Fit(NamedTuple):
    """A point, and the likelihoods there; of a climb the maximum within the bounds of the prior."""

    coordinates: Coordinates
    w: np.ndarray  # (d,) in these
    events: list[Comparison]  # with derivatives
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
        """Measure some parameters (d,) of the point from a bound."""
        new, z = self.coordinates._replace(near=near & (self.coordinates.sides > 0)), self.z
        ratio = self.coordinates.slopes(z) / new.slopes(z)
        events = [
            e._replace(sensitivities=e.sensitivities * ratio, of_scale=e.of_scale * ratio)
            for e in self.events
        ]
        return self._replace(coordinates=new, w=np.clip(new.of(z), *new.limits), events=events)


class Predictions:
    """Compiled predictions of all likelihoods of a model."""

    def __init__(self, model):
        self.model, self.space, self.count = model, Unconstrained(model), 0
        self.comparisons, self.bounds = comparisons(model), bounds_of(model, self.space)
        sides = np.isfinite(self.bounds(self.space.point)).sum(axis=0)
        self.coordinates = Coordinates(sides, sides < 0, self.space.join(self.space.point))
        self.function = self.compiled([x for one in self.comparisons for x in one[:5]])
        behind = [frequencies_behind(one.mu) for one in self.comparisons]
        self.modes = [pair and (self.compiled(pair[0], **PLAINLY), pair[1]) for pair in behind]

    def compiled(self, tensors, **settings):
        """A function of the values of the unconstrained variables."""
        tensors = self.model.replace_rvs_by_values([pt.as_tensor_variable(x) for x in tensors])
        settings = settings or with_mode({"on_unused_input": "ignore"}, tensors)
        return compile_function(list(self.model.value_vars), tensors, **settings)

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
        point = self.space.split(z).values()
        return [pair and pair[1](pair[0](*point)) for pair in self.modes]


def events_at(predictions, coordinates, w, steps, here, central=True) -> list[Comparison]:
    """Predictions `here`, with derivatives by differences over steps (d,), within limits, at a point (d,)."""
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
        events.append(value._replace(sensitivities=value.scaled(mu), of_scale=log_scale))
    return events
