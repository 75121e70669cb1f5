"""PyMC's independent Metropolis-Hastings kernel for posteriors of any scale."""

import numpy as np
from pymc.smc.kernels import IMH
from scipy import stats

RELATIVE_JITTER = 1e-9


class RelativeIMH(IMH):
    """Independent Metropolis-Hastings for `pm.sample_smc`, regularised relative to the posterior's scale.

    PyMC's `IMH` adds 1e-6 to the variances of its proposal. Where the posterior is narrower than 1e-3 in the
    sampled coordinates, as it is for thousands of samples taken as independent, that proposal misses it
    and the acceptance falls to a few per cent. Here the variances grow by a factor 1 + 1e-9 instead;
    everything else is PyMC's.

    See Also
    --------
    pymc.smc.kernels.IMH : parameters and settings.
    """

    def tune(self):
        """Fit the proposal to mean and covariance of the resampled particles."""
        covariance = np.atleast_2d(np.cov(self.tempered_posterior, ddof=0, rowvar=False))
        variances = np.diag(covariance)
        if not np.isfinite(covariance).all() or not (variances > 0).all():
            raise ValueError(
                "the particles of a stage must differ in every parameter, got a variance of "
                f"{variances.min():g}. Increase `draws`: too few of them were inside the posterior."
            )
        covariance = covariance + RELATIVE_JITTER * np.diag(variances)
        mean = self.tempered_posterior.mean(axis=0)
        self.proposal_dist = stats.multivariate_normal(mean, covariance, allow_singular=True)
