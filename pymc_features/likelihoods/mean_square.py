"""Likelihoods of the mean-square discrepancy of each sensor: TN, EXP, and any number of degrees of freedom.

A feature likelihood puts a probability model on the mean-square discrepancy e_j of each sensor, Eq. (3),
not on its time samples: e_j / sigma^2 is chi-square with m degrees of freedom, 1 for TN (a half-normal on
the root mean square), 2 for EXP (an exponential on the mean square), any number for GammaFeature.

As a density of the *feature* it is what the source writes, Eqs. (7) and (9). A draw of the data with this
feature and no preferred direction is y = mu + R u, with R = sqrt(N_D e) and u uniform on the unit sphere of
N_D dimensions; its density is that of the radius over the area of its sphere,

    p(y) = p_R(R) Gamma(N_D / 2) / (2 pi^(N_D / 2) R^(N_D - 1)).

Data may have gaps, NaN: e_j is the mean over the samples of a sensor that were measured, whose number takes
the place of N_D in the density of the data. Draws have no gaps.
"""

from collections.abc import Sequence

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pymc.distributions.dist_math import check_parameters
from pymc.distributions.distribution import Continuous, SymbolicRandomVariable, _support_point
from pymc.distributions.shape_utils import implicit_size_from_params, maybe_resize, rv_size_is_none
from pymc.logprob.abstract import _logcdf, _logprob
from pymc.math import log1mexp
from pymc.pytensorf import normalize_rng_param, rvs_in_graph
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Variable
from pytensor.raise_op import CheckAndRaise
from pytensor.tensor import TensorLike, TensorVariable
from pytensor.tensor.random.utils import normalize_size_param
from scipy.special import gammaln

from pymc_features._checks import as_numbers, check_choice, check_name, shown
from pymc_features.likelihoods.declaration import (
    ADVICE,
    as_response,
    check_parameter,
    prepare_observed,
    shape_of,
    warn_about_the_posterior,
)
from pymc_features.ops import check_dims, mean_square_discrepancy, measured_samples, name_the_time_axis

DENSITIES = ("feature", "data")
RESIDUALS = "residuals"


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
            m = kwargs.get("m", cls.rv_types["feature"].degrees_of_freedom)
            observed, dims = prepare_observed(mu, observed, name, dims, gaps=True, sigma=sigma, m=m)
            warn_about_the_posterior(cls.__name__, m, mu, sigma, observed)
        name_the_time_axis(dims, mu, observed)
        return super().__new__(cls, name, mu, sigma, observed=observed, dims=dims, **kwargs)

    @classmethod
    def dist(
        cls, mu: TensorLike, sigma: TensorLike, *m: TensorLike, density: str = "feature", **kwargs
    ) -> TensorVariable:
        check_choice(density, "density", DENSITIES)
        mu = as_response(mu)
        return super().dist([mu, check_parameter("sigma", sigma, mu), *m], density=density, **kwargs)

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
        """Build the random variable of one density."""
        return cls.rv_types[density].rv_op(mu, sigma, *m, size=size, rng=rng)


class TruncNormalFeatureRV(FeatureRV):
    """Data whose root-mean-square discrepancy is half-normal."""

    name = "TruncNormalFeature"
    _print_name = ("TruncNormalFeature", "\\operatorname{TruncNormalFeature}")
    degrees_of_freedom = 1

    @staticmethod
    def feature_logp(e, sigma):
        return 0.5 * np.log(2.0 / np.pi) - pt.log(sigma) - e / (2.0 * pt.sqr(sigma))

    @staticmethod
    def feature_logcdf(e, sigma):
        z = pt.sqrt(0.5 * e) / sigma
        return pt.switch(z < 1.0, pt.log(pt.erf(z)), pt.log1p(-pt.erfc(z)))


class TruncNormalFeatureDataRV(TruncNormalFeatureRV):
    """Draws of `TruncNormalFeature`, with their density over the data."""

    density = "data"


class TruncNormalFeature(FeatureLikelihood):
    r"""TN likelihood: the root-mean-square discrepancy of each sensor is half-normal.

    .. math::

        \ln p = \sum_j \left[ \frac{1}{2} \ln\frac{2}{\pi} - \ln\sigma - \frac{e_j}{2 \sigma^2} \right],
        \qquad e_j = \frac{1}{N_D} \sum_k [y_j(k) - g_j(k; \theta)]^2

    Its uncertainty does not depend on the sampling rate of the data.

    Parameters
    ----------
    mu : tensor_like (..., sensor, time)
        Response of the model, usually from `response`; the discrepancy is then computed without
        storing the history.
    sigma : tensor_like () or (..., sensor)
        Scale of the root-mean-square discrepancy, in the units of the data; positive.
    density : {"feature", "data"}
        "feature" (default): Eq. (7), a density of the feature, hence a generalised (Gibbs) posterior
        with about one effective observation for each sensor. "data": divided by the area of the
        sphere of data with the same feature; a proper density of the data, consistent with the draws,
        and the one that simulation-based calibration can test.

    Raises
    ------
    ValueError, TypeError
        If shapes do not match, `observed` has infinities or no data of a sensor, or a literal `sigma` is not
        positive.

    Warns
    -----
    FeatureLikelihoodWarning
        With four sensors or fewer under one unknown sigma the posterior has no finite variance; with
        noise-free data sigma runs to zero.

    Notes
    -----
    One log-likelihood value for each sensor; the support dimension is time, the last. `pm.logcdf` is the
    probability of a smaller root mean square. Evidence and LOO of a feature likelihood must not be
    compared with those of a pointwise Gaussian: they are densities of different things.

    `observed` may have gaps, NaN or masked, each sensor its own: e_j is the mean over the samples measured,
    whose number takes the place of N_D in the density of the data. Draws have no gaps.

    References
    ----------
    Eqs. (4)-(7) of the source; Eq. (4) is read with e_j, not e_j^2, in the exponent, which
    reproduces Eq. (7) constants included.

    Examples
    --------
    >>> import numpy as np, pymc as pm
    >>> y = TruncNormalFeature.dist(mu=np.zeros((1, 4)), sigma=2.0)
    >>> float(pm.logp(y, np.full((1, 4), 2.0)).eval()[0])  # 0.5 ln(2/pi) - ln 2 - 1/2
    -1.4189385332046727
    """

    rv_type = TruncNormalFeatureRV
    rv_types = {"feature": TruncNormalFeatureRV, "data": TruncNormalFeatureDataRV}


class ExpFeatureRV(FeatureRV):
    """Data whose mean-square discrepancy is exponential with rate 1 / (2 sigma^2)."""

    name = "ExpFeature"
    _print_name = ("ExpFeature", "\\operatorname{ExpFeature}")
    degrees_of_freedom = 2

    @staticmethod
    def feature_logp(e, sigma):
        return -np.log(2.0) - 2.0 * pt.log(sigma) - e / (2.0 * pt.sqr(sigma))

    @staticmethod
    def feature_logcdf(e, sigma):
        return log1mexp(-e / (2.0 * pt.sqr(sigma)))


class ExpFeatureDataRV(ExpFeatureRV):
    """Draws of `ExpFeature`, with their density over the data."""

    density = "data"


class ExpFeature(FeatureLikelihood):
    r"""EXP likelihood: the mean-square discrepancy of each sensor is exponential.

    .. math::

        \ln p = \sum_j \left[ -\ln 2 - 2 \ln\sigma - \frac{e_j}{2 \sigma^2} \right],
        \qquad e_j = \frac{1}{N_D} \sum_k [y_j(k) - g_j(k; \theta)]^2

    Its uncertainty does not depend on the sampling rate of the data, nor does that of likelihood-free ABC,
    whose interval at the tolerance `likelihoods.abc_tolerance` is about twice as wide.

    Parameters
    ----------
    mu : tensor_like (..., sensor, time)
        Response of the model, usually from `response`; the discrepancy is then computed without
        storing the history.
    sigma : tensor_like () or (..., sensor)
        Scale: 2 sigma^2 is the expected mean-square discrepancy, in squared units of the data; positive.
    density : {"feature", "data"}
        "feature" (default): Eq. (9), a density of e_j, hence a generalised (Gibbs) posterior. "data": a
        proper density of the data, consistent with the draws; see `TruncNormalFeature`.

    Raises
    ------
    ValueError, TypeError
        If shapes do not match, `observed` has infinities or no data of a sensor, or a literal `sigma` is not
        positive.

    Warns
    -----
    FeatureLikelihoodWarning
        With two sensors or fewer under one unknown sigma the posterior has no finite variance; with
        noise-free data sigma runs to zero.

    Notes
    -----
    The root of e_j is Rayleigh. See `TruncNormalFeature` for dimensions, evidence, LOO and gaps in the data.

    References
    ----------
    Eqs. (8)-(9) of the source.

    Examples
    --------
    >>> import numpy as np, pymc as pm
    >>> y = ExpFeature.dist(mu=np.zeros((1, 4)), sigma=2.0)
    >>> float(pm.logp(y, np.full((1, 4), 2.0)).eval()[0])  # -3 ln 2 - 1/2
    -2.5794415416798357
    """

    rv_type = ExpFeatureRV
    rv_types = {"feature": ExpFeatureRV, "data": ExpFeatureDataRV}


def sigma_mpv(e: ArrayLike) -> float | np.ndarray:
    """Most probable sigma under EXP and a flat prior, given the discrepancies, Eqs. (10)-(13).

    sigma_MPV^2 = (1 / (2 N_0)) sum_j e_j.

    Parameters
    ----------
    e : array_like (..., sensor)
        Mean-square discrepancies, from `mean_square_discrepancy`.

    Returns
    -------
    float or array (...,)
        In the units of the data.

    Examples
    --------
    >>> sigma_mpv([2.0, 6.0])
    1.4142135623730951
    """
    given, e = e, as_numbers(e, "e", "Pass what `mean_square_discrepancy` returned.")
    if e.ndim == 0 or e.size == 0 or not (np.isfinite(e) & (e >= 0)).all():
        raise ValueError(
            f"`e` must be mean squares, finite and not negative, one for each sensor, got {shown(given)}. "
            "Pass what `mean_square_discrepancy` returned."
        )
    result = np.sqrt(0.5 * np.mean(e, axis=-1))
    return float(result) if np.ndim(result) == 0 else result


class RequireDegrees(CheckAndRaise):
    """Degrees of freedom that are data of the model, once they are filled; before that an error.

    They are known before the first evaluation or never: no sampler can start and fail on its way.
    """


def check_degrees(m, mu) -> TensorVariable:
    """Return m as a tensor; refuse what is not positive or does not fit the sensors."""
    if isinstance(m, str):
        advice = (
            "Only a likelihood of a model, GammaFeature(name, ...), can take them from residuals."
            if m == RESIDUALS
            else ADVICE["m"]
        )
        raise ValueError(f"`m` must be positive numbers or, in a model, 'residuals', got {m!r}. {advice}")
    return check_parameter("m", m, as_response(mu))


def unfilled_degrees(name, observed, dims) -> TensorVariable:
    """The data `{name}_m` of the model, a value for each sensor, refused until they are filled."""
    if observed is None:
        raise ValueError(
            "`observed` must be given with m='residuals', got None. Pass the measured response (sensor, "
            "time)."
        )
    shape = shape_of(observed) if isinstance(observed, Variable) else as_numbers(observed, "observed").shape
    if not shape:
        raise ValueError("`observed` must have shape (..., sensor, time), got a scalar.")
    if None in shape[:-1]:
        raise ValueError(
            f"`observed` must have a known number of sensors with m='residuals', got shape {shape}. Pass an "
            "array or pm.Data."
        )
    labels = None if dims is None or len(dims) != len(shape) else tuple(dims)[:-1]
    data = pm.Data(f"{name}_m", np.zeros(shape[:-1]), dims=labels)
    message = (
        f"`m` of {name} must be taken from the residuals before anything else, got no values. Call "
        "calibration.fill_degrees() in the model's context, and again when data have changed."
    )
    return RequireDegrees(ValueError, message)(data, pt.all(data > 0))


class GammaFeatureRV(FeatureRV):
    """Data whose mean-square discrepancy over sigma^2 is chi-square with m degrees of freedom, its input."""

    name = "GammaFeature"
    extended_signature = "[rng],[size],(t),(),()->[rng],(t)"
    _print_name = ("GammaFeature", "\\operatorname{GammaFeature}")

    @staticmethod
    def feature_logp(e, sigma, m):
        constant = -0.5 * m * np.log(2.0) - pt.gammaln(0.5 * m + 1.0)
        return constant - m * pt.log(sigma) - e / (2.0 * pt.sqr(sigma))

    @staticmethod
    def feature_logcdf(e, sigma, m):
        x = e / (2.0 * pt.sqr(sigma))
        below = pt.log(pt.gammainc(0.5 * m, x))
        return pt.switch(x < 0.5 * m, below, pt.log1p(-pt.gammaincc(0.5 * m, x)))


class GammaFeatureDataRV(GammaFeatureRV):
    """Draws of `GammaFeature`, with their density over the data."""

    density = "data"


class GammaFeature(FeatureLikelihood):
    r"""Feature likelihood with any number of independent observations m for each sensor.

    .. math::

        \ln p = \sum_j \left[ -\frac{m_j}{2} \ln 2 - \ln\Gamma(\frac{m_j}{2} + 1) - m_j \ln\sigma
        - \frac{e_j}{2 \sigma^2} \right],
        \qquad e_j = \frac{1}{N_D} \sum_k [y_j(k) - g_j(k; \theta)]^2

    e_j / sigma^2 is chi-square with m_j degrees of freedom: e_j has a gamma distribution of shape m_j / 2
    and mean m_j sigma^2. m = 1 is `TruncNormalFeature`, m = 2 is `ExpFeature`, and m = N_D is the
    conventional likelihood of N_D independent samples whose standard deviation is sigma sqrt(N_D). In
    between, m is the number of independent observations that the errors of a sensor are worth, which
    `effective_samples` takes from the residuals of a fit, and which does not depend on the sampling rate;
    with ``m="residuals"`` `calibration.fill_degrees` puts it in.

    Parameters
    ----------
    mu : tensor_like (..., sensor, time)
        Response of the model, usually from `response`; the discrepancy is then computed without
        storing the history.
    sigma : tensor_like () or (..., sensor)
        Scale: m sigma^2 is the expected mean-square discrepancy, in squared units of the data; positive.
    m : tensor_like () or (sensor,), or "residuals"
        Degrees of freedom of each sensor: positive numbers, `pm.Data`, or with ``density="data"`` a random
        variable. "residuals" registers the data `{name}_m`, one value for each sensor, which `fill_degrees`
        takes from the residuals of a fit.
    density : {"feature", "data"}
        "feature" (default): the density of e_j^(m/2), as TN's is that of the root mean square and EXP's that
        of the mean square; a generalised (Gibbs) posterior. "data": a proper density of the data, consistent
        with the draws; with m = N_D exactly that of independent Gaussian samples.

    Raises
    ------
    ValueError, TypeError
        If shapes do not match, `observed` has infinities or no data of a sensor, a literal `sigma` or `m` is
        not positive, or m has a prior and the density is that of the feature, which is another quantity for
        each m. With
        ``m="residuals"`` also at the first evaluation, whatever sampler asks for it, if `{name}_m` was not
        filled.

    Warns
    -----
    FeatureLikelihoodWarning
        With four degrees of freedom or fewer under one unknown sigma the posterior has no finite variance;
        with noise-free data sigma runs to zero.

    Notes
    -----
    `observed` may have gaps, see `TruncNormalFeature`. Independent Gaussian errors of standard deviation s,
    as of `pm.Normal`, are those with ``density="data"``, m the number N_j of samples of a sensor that were
    measured, and sigma = s / sqrt(N_j).

    Samplers do not fill m by themselves: a fit takes time, changes data of the model, and PyMC's own samplers
    would not do it, so that one model had two posteriors. An unfilled m is an error with all of them.

    References
    ----------
    Generalises Eqs. (4)-(9) of the source.

    Examples
    --------
    >>> import numpy as np, pymc as pm
    >>> y = GammaFeature.dist(mu=np.zeros((1, 4)), sigma=2.0, m=2.0)
    >>> float(pm.logp(y, np.full((1, 4), 2.0)).eval()[0].round(6))  # that of EXP, -3 ln 2 - 1/2
    -2.579442
    """

    rv_type = GammaFeatureRV
    rv_types = {"feature": GammaFeatureRV, "data": GammaFeatureDataRV}

    def __new__(
        cls,
        name: str,
        mu: TensorLike,
        sigma: TensorLike,
        m: TensorLike | str,
        *,
        observed: ArrayLike | SharedVariable | None = None,
        dims: Sequence[str] | None = None,
        **kwargs,
    ) -> TensorVariable:
        check_name(name)
        if isinstance(m, str) and m == RESIDUALS:
            m = unfilled_degrees(name, observed, check_dims(dims))
        else:
            m = check_degrees(m, mu)
        return super().__new__(cls, name, mu, sigma, m=m, observed=observed, dims=dims, **kwargs)

    @classmethod
    def dist(
        cls, mu: TensorLike, sigma: TensorLike, m: TensorLike, *, density: str = "feature", **kwargs
    ) -> TensorVariable:
        check_choice(density, "density", DENSITIES)
        m = check_degrees(m, mu)
        if density == "feature" and rvs_in_graph(m):
            raise ValueError(
                "`m` must be numbers under the density of the feature, got a random variable. Pass "
                "density='data'."
            )
        return super().dist(mu, sigma, m, density=density, **kwargs)
