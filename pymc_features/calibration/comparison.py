"""What each likelihood compares: a prediction with its data, in units of a scale.

Every likelihood here is, up to a constant, a sum over its sensors of

    ln L_j = -1/2 sum_k r_jk^2 - m_j ln s_j,

with residuals r scaled by s_j, and m_j the number of independent observations that it claims of a sensor: the
number of samples under NORM, 1 under TN, 2 under EXP. Errors with a known correlation are whitened first.
"""

from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Constant
from pytensor.tensor.random.basic import NormalRV

from pymc_features.distributions.correlated import CorrelatedNormalRV
from pymc_features.distributions.feature import FeatureRV
from pymc_features.ops import measured_samples, response_step


class Comparison(NamedTuple):
    """One likelihood: tensors that can be broadcast, or arrays at a point, see `by_sensor`.

    Attributes
    ----------
    mu, observed : (..., time)
        Prediction and data, which are NaN in gaps.
    scale : (..., time), or (..., 1) where it is constant in time
        Of the residuals: r = (observed - mu) / scale.
    claimed : (...,)
        m of each sensor.
    decay : (...,)
        Sampling step over correlation time; infinite for errors that are taken to be independent.
    step : float
        Sampling step [s]; NaN if it is not known.
    name : str
        Of the random variable.
    """

    mu: Any
    observed: Any
    scale: Any
    claimed: Any
    decay: Any = np.inf
    step: float = np.nan
    name: str = "y"

    @property
    def tensors(self) -> list:
        """What depends on the parameters or is data."""
        return [pt.as_tensor_variable(x) for x in self[:5]]

    def by_sensor(self, mu, observed, scale, claimed, decay) -> "Comparison":
        """The same with values of its tensors, arrays with one axis of sensors."""
        *sensors, n = observed.shape
        n_scale = n if np.shape(scale)[-1:] == (n,) else 1
        shapes = (n, n, n_scale)
        histories = [
            np.broadcast_to(x, (*sensors, k)).reshape(-1, k)
            for x, k in zip((mu, observed, scale), shapes, strict=True)
        ]
        numbers = [np.broadcast_to(x, sensors).ravel().astype(np.float64) for x in (claimed, decay)]
        return self._replace(**dict(zip(self._fields, [*histories, *numbers], strict=False)))

    def scaled(self, x) -> np.ndarray:
        """Histories (sensor, time, ...) in units of the scale, zero in gaps, without a known correlation."""
        along = (..., *[None] * (x.ndim - 2))
        x, gaps = x / self.scale[along], np.isnan(self.observed)
        return independent(np.where(gaps[along], 0.0, x) if gaps.any() else x, self.decay)

    @property
    def residuals(self) -> np.ndarray:
        """r (sensor, time), independent under the likelihood."""
        return self.scaled(self.observed - self.mu)

    @property
    def log_scale(self) -> np.ndarray:
        """ln s of each sensor."""
        return np.log(self.scale).mean(axis=-1)

    @property
    def log_likelihood(self) -> float:
        """Without constants."""
        return -0.5 * np.sum(self.residuals**2) - self.claimed @ self.log_scale


@singledispatch
def comparison(op, rv, observed) -> Comparison:
    """Describe a likelihood. Register a distribution's Op to make `effective_samples` know it."""
    raise TypeError(
        "`model` must have Normal, CorrelatedNormal or feature likelihoods, got "
        f"{type(op).__name__} ({rv.name}). Register it with pymc_features.calibration.comparison.comparison."
    )


@comparison.register(NormalRV)
def comparison_normal(op, rv, observed):
    """Every sample an independent observation."""
    mu, sigma = op.dist_params(rv.owner)
    return Comparison(mu, observed, sigma, observed.shape[-1], step=response_step(mu) or np.nan)


@comparison.register(FeatureRV)
def comparison_feature(op, rv, observed):
    """As many observations as there are degrees of freedom, each sample a part of them."""
    _, _, mu, sigma, *m = rv.owner.inputs
    n_measured = measured_samples(observed)
    root = pt.sqrt(pt.cast(observed.shape[-1], "float64") if n_measured is None else n_measured)
    scale = pt.as_tensor_variable(sigma * root)[..., None]
    return Comparison(mu, observed, scale, op.degrees(*m), step=response_step(mu) or np.nan)


@comparison.register(CorrelatedNormalRV)
def comparison_correlated(op, rv, observed):
    """Every sample an observation, once the correlation that the likelihood assumes is taken away."""
    _, _, mu, sigma, correlation_time, dt = rv.owner.inputs
    step = float(dt.data) if isinstance(dt, Constant) else response_step(mu) or np.nan
    return Comparison(mu, observed, sigma[..., None], observed.shape[-1], dt / correlation_time, step)


def independent(x, decay):
    """Signals (sensor, time, ...) without the correlation exp(-decay |k - l|) of unit variance.

    `decay` (sensor,); nothing changes where it is infinite.
    """
    if np.isinf(decay).all():
        return x
    shape = (len(x),) + (1,) * (x.ndim - 1)
    phi, share = np.exp(-decay).reshape(shape), -np.expm1(-2.0 * decay).reshape(shape)
    return np.concatenate([x[:, :1], (x[:, 1:] - phi * x[:, :-1]) / np.sqrt(share)], axis=1)
