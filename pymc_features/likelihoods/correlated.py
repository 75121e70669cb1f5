r"""Gaussian errors correlated in time: the other answer to dense sampling.

The covariance sigma^2 exp(-|k - l| dt / tau) of a sensor's errors is that of a stationary Ornstein-Uhlenbeck
process seen at the samples, r_k = phi r_{k-1} + sigma sqrt(1 - phi^2) z_k with phi = exp(-dt / tau), so that

    ln p = -N/2 ln(2 pi) - N ln sigma - (N - 1)/2 ln(1 - phi^2) - [r_0^2 + Q / (1 - phi^2)] / (2 sigma^2),
    Q = sum_{k>0} (r_k - phi r_{k-1})^2.

With S = sum r_k^2 and D = sum_{k>0} (r_k - r_{k-1})^2, and without the cancellation of nearly equal numbers
for phi near one,

    Q = phi D + (1 - phi) [r_last^2 - r_0^2 + (1 - phi) (S - r_last^2)]:

four numbers for each sensor, which the kernels give without a history.
"""

from collections.abc import Sequence

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pymc.distributions.dist_math import check_parameters
from pymc.distributions.distribution import Continuous, SymbolicRandomVariable, _support_point
from pymc.distributions.shape_utils import implicit_size_from_params, maybe_resize, rv_size_is_none
from pymc.logprob.abstract import _logprob
from pymc.pytensorf import normalize_rng_param
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Variable
from pytensor.tensor import TensorLike, TensorVariable
from pytensor.tensor.random.utils import normalize_size_param

from pymc_features._checks import check_name
from pymc_features.likelihoods.declaration import (
    as_response,
    check_dt,
    check_parameter,
    prepare_observed,
)
from pymc_features.likelihoods.mean_square import feature_support_point
from pymc_features.ops import misfit_statistics, name_the_time_axis


class CorrelatedNormalRV(SymbolicRandomVariable):
    """Response (..., time) plus a stationary Gaussian process of first order."""

    name = "CorrelatedNormal"
    extended_signature = "[rng],[size],(t),(),(),()->[rng],(t)"
    _print_name = ("CorrelatedNormal", "\\operatorname{CorrelatedNormal}")

    @classmethod
    def rv_op(
        cls,
        mu: TensorVariable,
        sigma: TensorVariable,
        correlation_time: TensorVariable,
        dt: TensorVariable,
        *,
        size: TensorVariable | None = None,
        rng: Variable | None = None,
    ) -> TensorVariable:
        """Build draws."""
        mu, *scalars = parameters = [pt.as_tensor_variable(x) for x in (mu, sigma, correlation_time, dt)]
        sigma, correlation_time, dt = scalars
        rng, size = normalize_rng_param(rng), normalize_size_param(size)
        full_size = size
        if rv_size_is_none(size):
            full_size = implicit_size_from_params(*parameters, ndims_params=[1, 0, 0, 0])
        next_rng, errors = standard_errors(dt / correlation_time, tuple(full_size), length(mu), rng)
        draws = mu + sigma[..., None] * errors
        return cls(inputs=[rng, size, *parameters], outputs=[next_rng, draws])(rng, size, *parameters)


def length(mu):
    """Number of samples: a Python number where it is known, which JAX needs."""
    return mu.type.shape[-1] or mu.shape[-1]


def standard_errors(rate, size, n_times, rng):
    """Draw (*size, time) with unit variance and correlation exp(-rate |k - l|), `rate` = dt / tau.

    Time is cut into about sqrt(N) blocks. Within each the recursion is a triangular product; what the blocks
    hand on to the next is a recursion of the same kind.
    """
    if isinstance(n_times, int):
        n = int(np.ceil(np.sqrt(n_times)))
        n_blocks = -(-n_times // n)
    else:
        n = pt.cast(pt.ceil(pt.sqrt(n_times)), "int64")
        n_blocks = (n_times + n - 1) // n
    next_rng, z = pt.random.normal(0.0, 1.0, size=(*size, n_blocks, n), rng=rng, return_next_rng=True)
    inside, between = pt.arange(n), pt.arange(n_blocks)
    is_first = pt.eq(between[:, None] + inside, 0)
    innovations = z * pt.switch(is_first, 1.0, pt.sqrt(-pt.expm1(-2.0 * rate))[..., None, None])
    within = pt.matmul(innovations, powers(rate[..., None, None], inside - inside[:, None]))
    handed_on = powers(n * rate[..., None, None], between - between[:, None] - 1)
    arrived = pt.matmul(within[..., None, :, -1], handed_on)[..., 0, :, None]
    errors = within + arrived * powers(rate[..., None], inside + 1)[..., None, :]
    return next_rng, errors.reshape((*size, n_blocks * n))[..., :n_times]


def powers(rate, lag):
    """exp(-rate lag), zero for negative lags; one at lag zero for an infinite rate, too."""
    return pt.switch(lag > 0, pt.exp(-rate * pt.maximum(lag, 1)), pt.eq(lag, 0))


def correlated_logp(statistics, sigma, rate, n_times):
    """Log-density of each sensor from its `misfit_statistics`; -inf where the response is not finite."""
    mean_square, mean_increment, first, last = (statistics[..., i] for i in range(4))
    n = pt.cast(n_times, "float64")
    phi, change, variance = pt.exp(-rate), -pt.expm1(-rate), -pt.expm1(-2.0 * rate)  # phi, 1 - phi, 1 - phi^2
    ends = (pt.sqr(last) - pt.sqr(first)) / n
    innovations = phi * mean_increment + change * (ends + change * (mean_square - pt.sqr(last) / n))
    squares = pt.sqr(first) + n * innovations / variance
    logp = (
        -0.5 * n * np.log(2.0 * np.pi)
        - n * pt.log(sigma)
        - 0.5 * (n - 1.0) * pt.log(variance)
        - squares / (2.0 * pt.sqr(sigma))
    )
    failed = pt.isnan(mean_square) | pt.isinf(mean_square)
    return pt.switch(failed | pt.eq(rate, 0.0), -np.inf, logp)


@_logprob.register(CorrelatedNormalRV)
def correlated_logprob(op, values, *inputs, **kwargs):
    """Log-likelihood of each sensor."""
    [value] = values
    _, size, mu, sigma, correlation_time, dt = inputs
    logp = correlated_logp(misfit_statistics(mu, value), sigma, dt / correlation_time, value.shape[-1])
    positive = {"sigma": sigma, "correlation_time": correlation_time, "dt": dt}
    logp = check_parameters(
        logp, *(x > 0 for x in positive.values()), msg=", ".join(f"{name} > 0" for name in positive)
    )
    return maybe_resize(logp, size)


_support_point.register(CorrelatedNormalRV)(feature_support_point)


class CorrelatedNormal(Continuous):
    r"""Gaussian errors whose correlation decays exponentially in time; sensors are independent.

    .. math::

        y_j \sim \mathcal{N}\!\left(g_j(\theta), \Sigma_j\right), \qquad
        \Sigma_{j, kl} = \sigma_j^2 \exp(-|k - l|\, \Delta t / \tau_j)

    The conventional likelihood is the limit of a correlation time much shorter than the sampling step.

    Parameters
    ----------
    mu : tensor_like (..., sensor, time)
        Response of the model, usually from `response`; the density is then computed without storing the
        history.
    sigma : tensor_like () or (..., sensor)
        Standard deviation of the errors, in the units of the data; positive.
    correlation_time : tensor_like () or (..., sensor)
        tau [s], after which the correlation has fallen to 1/e; positive.
    dt : float or tensor_like (), optional
        Sampling step of the data [s]; positive. By default the output step of the response; needed where
        that is `pm.Data`, or `mu` is no response.

    Raises
    ------
    ValueError, TypeError
        If shapes do not match, `observed` has NaN, a literal `sigma`, `correlation_time` or `dt` is not
        positive and finite, or `dt` is missing or is not the output step of the response.

    Notes
    -----
    The density is exact, at a cost and, in a population, a memory as those of the feature likelihoods; its
    gradient keeps the history of one particle. One log-likelihood value for each sensor; the support
    dimension is time, the last. Failed simulations, tau <= 0 and sigma <= 0 give -inf.

    With tau and sigma known, the information on the parameters converges as the sampling step goes to zero:
    that of about T / (2 tau) independent samples in a record of T seconds on what varies slowly. With sigma
    inferred it depends on the errors: if these are white, of standard deviation s, the estimate of sigma
    grows as s sqrt(tau / dt), and the information does not converge.

    References
    ----------
    Simoen, Papadimitriou and Lombaert (2013), On prediction error correlation in Bayesian model updating,
    Journal of Sound and Vibration 332, 4136-4152, doi:10.1016/j.jsv.2013.03.019. The process: Uhlenbeck and
    Ornstein (1930), On the theory of the Brownian motion, Physical Review 36, 823-841.

    Examples
    --------
    >>> import numpy as np, pymc as pm
    >>> tau = 1.0 / np.log(2.0)  # the correlation of neighbours is 1/2
    >>> y = CorrelatedNormal.dist(mu=np.zeros((1, 2)), sigma=1.0, correlation_time=tau, dt=1.0)
    >>> pm.logp(y, np.array([[1.0, 0.5]])).eval().round(6)  # -ln(2 pi) - ln(3/4) / 2 - 1/2
    array([-2.194036])
    """

    rv_type = CorrelatedNormalRV
    rv_op = CorrelatedNormalRV.rv_op

    def __new__(
        cls,
        name: str,
        mu: TensorLike,
        sigma: TensorLike,
        correlation_time: TensorLike,
        dt: TensorLike | None = None,
        *,
        observed: ArrayLike | SharedVariable | None = None,
        dims: Sequence[str] | None = None,
        **kwargs,
    ) -> TensorVariable:
        check_name(name)
        if observed is not None:
            parameters = {"sigma": sigma, "correlation_time": correlation_time}
            observed, dims = prepare_observed(mu, observed, name, dims, **parameters)
        dt = check_dt(dt, mu)
        name_the_time_axis(dims, mu, observed, dt)
        return super().__new__(
            cls, name, mu, sigma, correlation_time, dt, observed=observed, dims=dims, **kwargs
        )

    @classmethod
    def dist(
        cls,
        mu: TensorLike,
        sigma: TensorLike,
        correlation_time: TensorLike,
        dt: TensorLike | None = None,
        **kwargs,
    ) -> TensorVariable:
        mu, dt = as_response(mu), check_dt(dt, mu)
        correlation_time = check_parameter("correlation_time", correlation_time, mu)
        return super().dist([mu, check_parameter("sigma", sigma, mu), correlation_time, dt], **kwargs)
