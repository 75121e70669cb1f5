"""TN: a half-normal on the root mean square of the discrepancy, Eqs. (4)-(7)."""

import numpy as np
import pytensor.tensor as pt

from pymc_features.distributions.feature import FeatureLikelihood, FeatureRV


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

        \ln p = \sum_j \left[ \tfrac12 \ln\tfrac{2}{\pi} - \ln\sigma - \frac{e_j}{2 \sigma^2} \right],
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
