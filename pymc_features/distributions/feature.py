"""What the feature likelihoods share: draws, densities over the data, and the checks at the border.

A feature likelihood puts a probability model on the mean-square discrepancy e_j of each sensor, Eq. (3),
not on its time samples: e_j / sigma^2 is chi-square with m degrees of freedom, 1 for TN, 2 for EXP, any
number for GammaFeature.

As a density of the *feature* it is what the source writes, Eqs. (7) and (9). A draw of the data with this
feature and no preferred direction is y = mu + R u, with R = sqrt(N_D e) and u uniform on the unit sphere of
N_D dimensions; its density is that of the radius over the area of its sphere,

    p(y) = p_R(R) Gamma(N_D / 2) / (2 pi^(N_D / 2) R^(N_D - 1)).

Data may have gaps, NaN: e_j is the mean over the samples of a sensor that were measured, whose number takes
the place of N_D in the density of the data. Draws have no gaps.
"""

from collections.abc import Sequence

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pymc.distributions.dist_math import check_parameters
from pymc.distributions.distribution import Continuous, SymbolicRandomVariable, _support_point
from pymc.distributions.shape_utils import (
    implicit_size_from_params,
    maybe_resize,
    rv_size_is_none,
)
from pymc.logprob.abstract import _logcdf, _logprob
from pymc.pytensorf import normalize_rng_param
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Variable
from pytensor.tensor import TensorLike, TensorVariable
from pytensor.tensor.random.utils import normalize_size_param
from scipy.special import gammaln

from pymc_features._checks import check_choice, check_name
from pymc_features.distributions.checks import (
    as_response,
    check_one_set,
    check_sigma,
    prepare_observed,
    warn_about_the_posterior,
)
from pymc_features.ops import check_dims, mean_square_discrepancy, measured_samples, name_the_time_axis

DENSITIES = ("feature", "data")


class FeatureRV(SymbolicRandomVariable):
    """Data (..., time) whose mean-square distance from mu follows the law of a feature.

    A feature likelihood is a subclass with `degrees_of_freedom` m of e / sigma^2, a number or else its last
    input, and the log-density and log-probability of its feature.
    """

    extended_signature = "[rng],[size],(t),()->[rng],(t)"
    degrees_of_freedom: int | None = None
    density = "feature"

    @staticmethod
    def feature_logp(e, sigma, *m):
        """Log-density of the feature at mean square e (...,), constants included."""
        raise NotImplementedError

    @staticmethod
    def feature_logcdf(e, sigma, *m):
        """Log-probability that the feature is not larger than at mean square e."""
        raise NotImplementedError

    @classmethod
    def degrees(cls, *m):
        """Degrees of freedom: the class's own, or what is an input."""
        return m[0] if m else cls.degrees_of_freedom

    @classmethod
    def rv_op(cls, mu, sigma, *m, size=None, rng=None):
        """Build draws: the radius from the feature's law, the direction uniform on the sphere."""
        mu, sigma, *m = (pt.as_tensor_variable(x) for x in (mu, sigma, *m))
        rng = normalize_rng_param(rng)
        size = normalize_size_param(size)
        full_size = size
        if rv_size_is_none(size):
            full_size = implicit_size_from_params(mu, sigma, *m, ndims_params=[1, 0, *(0 for _ in m)])
        full_size = tuple(full_size)
        n_times = mu.shape[-1]
        middle_rng, normal = pt.random.normal(
            0.0, 1.0, size=(*full_size, n_times), rng=rng, return_next_rng=True
        )
        next_rng, chi_square = pt.random.gamma(
            0.5 * cls.degrees(*m),
            scale=2.0,
            size=full_size,
            rng=middle_rng,
            return_next_rng=True,
        )
        direction = normal / pt.sqrt(pt.sum(pt.sqr(normal), axis=-1, keepdims=True))
        radius = sigma * pt.sqrt(chi_square * n_times)
        draws = mu + radius[..., None] * direction
        inputs = [rng, size, mu, sigma, *m]
        return cls(inputs=inputs, outputs=[next_rng, draws])(*inputs)


@_logprob.register(FeatureRV)
def feature_logprob(op, values, *inputs, **kwargs):
    """Log-likelihood of each sensor; -inf where the response is not finite."""
    [value] = values
    _, size, mu, sigma, *m = inputs
    e = mean_square_discrepancy(mu, value)
    if op.density == "feature":
        logp = op.feature_logp(e, sigma, *m)
    else:
        n_measured = measured_samples(value)
        logp = data_logp(e, sigma, op.degrees(*m), value.shape[-1] if n_measured is None else n_measured)
    logp = pt.switch(pt.isnan(e) | pt.isinf(e), -np.inf, logp)
    return maybe_resize(_checked(logp, sigma, m), size)


def _checked(logp, sigma, m):
    """The log-density, or an error or -inf where sigma or the degrees of freedom are not positive."""
    conditions = [sigma > 0, *(x > 0 for x in m)]
    return check_parameters(logp, *conditions, msg="sigma > 0, m > 0" if m else "sigma > 0")


def log_gamma(x):
    """ln Gamma(x), of numbers too."""
    return pt.gammaln(x) if isinstance(x, Variable) else gammaln(x)


def data_logp(e, sigma, m, n_times):
    """Log-density of the data: that of the radius over the area of its sphere.

    sqrt(e) / sigma is chi with m degrees of freedom, R = sqrt(N_D e). The powers of e are collected, so
    that no infinities are subtracted at e = 0.
    """
    n = pt.cast(n_times, "float64")
    log_chi = (1.0 - 0.5 * m) * np.log(2.0) - log_gamma(0.5 * m)
    log_area = np.log(2.0) + 0.5 * n * np.log(np.pi) - pt.gammaln(0.5 * n)
    log_power = pt.switch(pt.eq(n, m), 0.0, 0.5 * (m - n) * pt.log(e))
    radial = log_chi - m * pt.log(sigma) - e / (2.0 * pt.sqr(sigma))
    return radial - 0.5 * n * pt.log(n) - log_area + log_power


@_logcdf.register(FeatureRV)
def feature_logcdf(op, value, *inputs, **kwargs):
    """Log-probability of a smaller feature, for each sensor."""
    _, size, mu, sigma, *m = inputs
    logcdf = op.feature_logcdf(mean_square_discrepancy(mu, value), sigma, *m)
    return maybe_resize(_checked(logcdf, sigma, m), size)


@_support_point.register(FeatureRV)
def feature_support_point(op, rv, *inputs):
    """Return the response itself."""
    return pt.broadcast_to(inputs[2], rv.shape)


class FeatureLikelihood(Continuous):
    """Base of the feature likelihoods; `rv_types` maps each density to its random variable."""

    rv_types: dict[str, type[FeatureRV]] = {}

    def __init_subclass__(cls, **kwargs):
        super().__init_subclass__(**kwargs)
        cls.rv_op = FeatureLikelihood.__dict__["rv_op"]  # PyMC's metaclass has just hidden it

    def __new__(
        cls,
        name: str,
        mu: TensorLike,
        sigma: TensorLike,
        *,
        observed: ArrayLike | SharedVariable | None = None,
        dims: Sequence[str] | None = None,
        **kwargs,
    ) -> TensorVariable:
        check_name(name)
        if observed is not None:
            observed = prepare_observed(mu, observed, name, dims, gaps=True)
            dims = check_dims(dims, observed.ndim)
            m = kwargs.get("m", cls.rv_types["feature"].degrees_of_freedom)
            check_one_set(mu, sigma=sigma, m=m)
            warn_about_the_posterior(cls.__name__, m, mu, sigma, observed)
        name_the_time_axis(dims, mu, observed)
        return super().__new__(cls, name, mu, sigma, observed=observed, dims=dims, **kwargs)

    @classmethod
    def dist(
        cls, mu: TensorLike, sigma: TensorLike, *m: TensorLike, density: str = "feature", **kwargs
    ) -> TensorVariable:
        check_choice(density, "density", DENSITIES)
        mu = as_response(mu)
        return super().dist([mu, check_sigma(sigma, mu), *m], density=density, **kwargs)

    @classmethod
    def rv_op(
        cls,
        mu: TensorVariable,
        sigma: TensorVariable,
        *m: TensorVariable,
        density: str = "feature",
        size: TensorVariable | None = None,
        rng: Variable | None = None,
    ) -> TensorVariable:
        """Build the random variable of the wanted density."""
        return cls.rv_types[density].rv_op(mu, sigma, *m, size=size, rng=rng)
