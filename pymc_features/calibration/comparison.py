"""What each likelihood compares: a prediction with its data, in units of a scale.

Every likelihood here is, up to a constant, a sum over its sensors of

    ln L_j = -1/2 sum_k r_jk^2 - m_j ln s_j,

with residuals r scaled by s_j, and m_j the number of independent observations that it claims of a sensor: the
number of samples under NORM, 1 under TN, 2 under EXP. Errors with a known correlation are whitened first.
"""

from functools import singledispatch
from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Constant
from pytensor.tensor.random.basic import NormalRV

from pymc_features.distributions.correlated import CorrelatedNormalRV
from pymc_features.distributions.feature import FeatureRV
from pymc_features.ops import measured_samples, response_step


class Comparison(NamedTuple):
    """Tensors that describe one likelihood.

    Attributes
    ----------
    mu, observed : TensorVariable (..., time)
        Prediction and data.
    scale : TensorVariable (..., time)
        Of the residuals: r = (observed - mu) / scale.
    log_scale : TensorVariable (...,)
        ln s of each sensor.
    claimed : TensorVariable (...,)
        m of each sensor.
    decay : TensorVariable (...,)
        Sampling step over correlation time; infinite for errors that are taken to be independent.
    step : float
        Sampling step [s]; NaN if it is not known.
    """

    mu: pt.TensorVariable
    observed: pt.TensorVariable
    scale: pt.TensorVariable
    log_scale: pt.TensorVariable
    claimed: pt.TensorVariable
    decay: pt.TensorVariable
    step: float

    @property
    def tensors(self):
        """All but the step."""
        return self[:-1]


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
    sigma = pt.broadcast_to(sigma, observed.shape)
    log_scale = pt.log(sigma).mean(axis=-1)
    n = pt.cast(observed.shape[-1], "float64")
    return described(mu, observed, sigma, log_scale, pt.full_like(log_scale, 1.0) * n, np.inf)


@comparison.register(FeatureRV)
def comparison_feature(op, rv, observed):
    """As many observations as there are degrees of freedom, each sample a part of them."""
    _, _, mu, sigma, *m = rv.owner.inputs
    sigma = pt.broadcast_to(sigma, observed.shape[:-1])
    n_measured = measured_samples(observed)
    root = pt.sqrt(pt.cast(observed.shape[-1], "float64") if n_measured is None else n_measured)
    scale = pt.broadcast_to((sigma * root)[..., None], observed.shape)
    claimed = pt.broadcast_to(pt.as_tensor_variable(op.degrees(*m)), sigma.shape).astype("float64")
    return described(mu, observed, scale, pt.log(sigma), claimed, np.inf)


@comparison.register(CorrelatedNormalRV)
def comparison_correlated(op, rv, observed):
    """Every sample an observation, once the correlation that the likelihood assumes is taken away."""
    _, _, mu, sigma, correlation_time, dt = rv.owner.inputs
    sigma = pt.broadcast_to(sigma, observed.shape[:-1])
    n = pt.cast(observed.shape[-1], "float64")
    scale = pt.broadcast_to(sigma[..., None], observed.shape)
    return described(
        mu, observed, scale, pt.log(sigma), pt.full_like(sigma, 1.0) * n, dt / correlation_time, dt
    )


def described(mu, observed, scale, log_scale, claimed, decay, dt=None):
    """The comparison with everything a tensor."""
    decay = pt.as_tensor_variable(np.float64(decay) if np.isscalar(decay) else decay)
    step = float(dt.data) if isinstance(dt, Constant) else response_step(mu) or np.nan
    mu, observed = pt.broadcast_to(mu, observed.shape), pt.as_tensor_variable(observed)
    return Comparison(mu, observed, scale, log_scale, claimed, pt.broadcast_to(decay, log_scale.shape), step)


def independent(x, decay):
    """Signals (sensor, time, ...) without the correlation exp(-decay |k - l|) of unit variance.

    `decay` (sensor,); nothing changes where it is infinite.
    """
    shape = (len(x),) + (1,) * (x.ndim - 1)
    phi, share = np.exp(-decay).reshape(shape), -np.expm1(-2.0 * decay).reshape(shape)
    return np.concatenate([x[:, :1], (x[:, 1:] - phi * x[:, :-1]) / np.sqrt(share)], axis=1)
