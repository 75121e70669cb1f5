"""EXP: an exponential law on the mean-square discrepancy, Eqs. (8)-(9), and its best sigma."""

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pymc.math import log1mexp

from pymc_features._checks import as_numbers, shown
from pymc_features.distributions.feature import FeatureLikelihood, FeatureRV


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
    whose interval at the tolerance `abc_tolerance` is about twice as wide.

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
