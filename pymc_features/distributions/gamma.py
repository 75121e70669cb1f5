"""Any number of degrees of freedom: the mean-square discrepancy of a sensor has a gamma distribution."""

from collections.abc import Sequence

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pymc.pytensorf import rvs_in_graph
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Variable
from pytensor.raise_op import CheckAndRaise
from pytensor.tensor import TensorLike, TensorVariable

from pymc_features._checks import as_numbers, check_choice, check_name
from pymc_features.distributions.checks import as_response, check_degrees_of_freedom, shape_of
from pymc_features.distributions.feature import DENSITIES, FeatureLikelihood, FeatureRV
from pymc_features.ops import check_dims

RESIDUALS = "residuals"


class Filled(CheckAndRaise):
    """Degrees of freedom that are data of the model, once they are filled; an error before.

    They are known before the first evaluation or never: no sampler can start and fail on its way.
    """


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
        "fill_degrees() in the model's context, and again when data have changed."
    )
    return Filled(ValueError, message)(data, pt.all(data > 0))


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

        \ln p = \sum_j \left[ -\tfrac{m_j}{2} \ln 2 - \ln\Gamma(\tfrac{m_j}{2} + 1) - m_j \ln\sigma
        - \frac{e_j}{2 \sigma^2} \right],
        \qquad e_j = \frac{1}{N_D} \sum_k [y_j(k) - g_j(k; \theta)]^2

    e_j / sigma^2 is chi-square with m_j degrees of freedom: e_j has a gamma distribution of shape m_j / 2
    and mean m_j sigma^2. m = 1 is `TruncNormalFeature`, m = 2 is `ExpFeature`, and m = N_D is the
    conventional likelihood of N_D independent samples whose standard deviation is sigma sqrt(N_D). In
    between, m is the number of independent observations that the errors of a sensor are worth, which
    `effective_samples` takes from the residuals of a fit, and which does not depend on the sampling rate;
    with ``m="residuals"`` `fill_degrees` puts it in.

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
            m = check_degrees_of_freedom(m, as_response(mu))
        return super().__new__(cls, name, mu, sigma, m=m, observed=observed, dims=dims, **kwargs)

    @classmethod
    def dist(
        cls, mu: TensorLike, sigma: TensorLike, m: TensorLike, *, density: str = "feature", **kwargs
    ) -> TensorVariable:
        check_choice(density, "density", DENSITIES)
        m = check_degrees_of_freedom(m, as_response(mu))
        if density == "feature" and rvs_in_graph(m):
            raise ValueError(
                "`m` must be numbers under the density of the feature, got a random variable. Pass "
                "density='data'."
            )
        return super().dist(mu, sigma, m, density=density, **kwargs)
