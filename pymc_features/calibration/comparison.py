"""What each likelihood compares: a prediction with its data, in units of a scale.

Every likelihood here is, up to a constant, a sum over its sensors of

    ln L_j = -1/2 sum_k r_jk^2 - m_j ln s_j,

with residuals r scaled by s_j, and m_j the number of independent observations that it claims of a sensor: the
number of samples under NORM, 1 under TN, 2 under EXP. Errors with a known correlation are whitened first.
Gaps in the data are NaN; residuals and sensitivities are zero there.
"""

from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np
import pytensor.tensor as pt
from pytensor.compile.mode import Mode
from pytensor.graph.basic import Constant
from pytensor.tensor.random.basic import NormalRV

from pymc_features.likelihoods.correlated import CorrelatedNormalRV
from pymc_features.likelihoods.mean_square import FeatureRV
from pymc_features.ops import measured_samples, response_step

MOST = 0.4  # share of the record in gaps of one sensor or another; of more the intervals become too narrow


class Comparison(NamedTuple):
    """One likelihood: tensors that can be broadcast, or arrays at a point, see `by_sensor`."""

    mu: Any  # prediction (..., time)
    observed: Any  # data (..., time)
    scale: Any  # of the residuals (observed - mu) / scale (..., time), or (..., 1) where constant in time
    claimed: Any  # m (...,) of each sensor
    decay: Any = np.inf  # sampling step over correlation time (...,); infinite for independent errors
    step: float = np.nan  # of the samples [s]; NaN if it is not known
    name: str = "y"  # of the random variable

    def by_sensor(self) -> "Comparison":
        """Turn arrays into ones with one axis of sensors."""
        mu, observed, scale, claimed, decay, *known = self
        *sensors, n = observed.shape
        n_scale = n if np.shape(scale)[-1:] == (n,) else 1
        mu, observed, scale = (
            np.broadcast_to(x, (*sensors, k)).reshape(-1, k)
            for x, k in ((mu, n), (observed, n), (scale, n_scale))
        )
        numbers = (np.broadcast_to(x, sensors).ravel().astype(np.float64) for x in (claimed, decay))
        return Comparison(mu, observed, scale, *numbers, *known)

    @property
    def gaps(self) -> np.ndarray:
        """Samples (sensor, time) that were not measured."""
        return np.isnan(self.observed)

    def scaled(self, x) -> np.ndarray:
        """Histories (sensor, time, ...) in units of the scale, zero in gaps, without a known correlation."""
        along = (..., *[None] * (x.ndim - 2))
        x, gaps = x / self.scale[along], self.gaps
        return independent(np.where(gaps[along], 0.0, x) if gaps.any() else x, self.decay)

    @property
    def residuals(self) -> np.ndarray:
        """r (sensor, time), independent under the likelihood."""
        return self.scaled(self.observed - self.mu)

    @property
    def log_scale(self) -> np.ndarray:
        """ln s (sensor,)."""
        return np.log(self.scale).mean(axis=-1)


def independent(x, decay):
    """Signals (sensor, time, ...) without the correlation exp(-decay |k - l|) of unit variance."""
    if np.isinf(decay).all():
        return x
    shape = (len(x),) + (1,) * (x.ndim - 1)
    phi, share = np.exp(-decay).reshape(shape), -np.expm1(-2.0 * decay).reshape(shape)
    return np.concatenate([x[:, :1], (x[:, 1:] - phi * x[:, :-1]) / np.sqrt(share)], axis=1)


def log_likelihood(values: list[Comparison]) -> float:
    """Sum all log-likelihoods, without constants; minus infinity where that is not finite."""
    total = sum(-0.5 * np.sum(v.residuals**2) - v.claimed @ v.log_scale for v in values)
    return total if np.isfinite(total) else -np.inf


def step_of(mu) -> float:
    """Sampling step [s] of a prediction as it is now, NaN of one that is no response."""
    return response_step(mu, at_present=True) or np.nan


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
    return Comparison(mu, observed, sigma, observed.shape[-1], step=step_of(mu))


@comparison.register(FeatureRV)
def comparison_feature(op, rv, observed):
    """Take as many observations as there are degrees of freedom, each sample a part of them."""
    _, _, mu, sigma, *m = rv.owner.inputs
    n_measured = measured_samples(observed)
    root = pt.sqrt(pt.cast(observed.shape[-1], "float64") if n_measured is None else n_measured)
    scale = pt.as_tensor_variable(sigma * root)[..., None]
    return Comparison(mu, observed, scale, op.degrees(*m), step=step_of(mu))


@comparison.register(CorrelatedNormalRV)
def comparison_correlated(op, rv, observed):
    """Every sample an observation, once the correlation that the likelihood assumes is taken away."""
    _, _, mu, sigma, correlation_time, dt = rv.owner.inputs
    step = float(dt.data) if isinstance(dt, Constant) else step_of(mu)
    return Comparison(mu, observed, sigma[..., None], observed.shape[-1], dt / correlation_time, step)


def comparisons(model) -> list[Comparison]:
    """All likelihoods of a model.

    Gaps are refused in what is no feature likelihood, and more of them than leave a spectrum to be seen.
    """
    if not model.observed_RVs:
        raise ValueError("`model` must have observed variables, got none.")
    pairs = [(rv, model.rvs_to_values[rv]) for rv in model.observed_RVs]
    found = [comparison(rv.owner.op, rv, data)._replace(name=rv.name) for rv, data in pairs]
    for rv, data in pairs:
        gaps = np.isnan(data.eval(mode=Mode(linker="py", optimizer=None)))
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
    return found
