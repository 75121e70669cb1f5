"""PyMC's independent Metropolis-Hastings kernel on whole populations."""

import numpy as np
from pymc.pytensorf import floatX
from pymc.smc.kernels import IMH

from pymc_features.smc.kernels.base import PopulationKernel


class PopulationIMH(PopulationKernel, IMH):
    """Independent Metropolis-Hastings: the particles of `pymc.smc.kernels.IMH`, evaluated all at once.

    Parameters
    ----------
    correlation_threshold : float
        Steps of a stage go on while the correlation with its first particles falls by more than this.
    **settings
        Of `PopulationKernel`.

    Notes
    -----
    The same seed gives the same particles as PyMC's kernel (tests/smc/test_population.py). Like there,
    1e-6 is added to the variances of the proposal, which starves posteriors narrower than 1e-3 in the sampled
    coordinates: take `PersistentSMC` for those.
    """

    stats_dtypes_shapes = {**PopulationKernel.stats_dtypes_shapes, "accept_rate": (float, [])}

    def __init__(self, *args, correlation_threshold=0.01, **settings):
        PopulationKernel.__init__(self, *args, **settings)
        self.correlation_threshold = correlation_threshold
        self.proposal_dist = None

    def propose(self):
        """Draw from the Gaussian fitted to the resampled particles."""
        proposal = floatX(self.proposal_dist.rvs(size=self.draws, random_state=self.rng))
        proposal = proposal.reshape(len(proposal), -1)
        forward = self.proposal_dist.logpdf(proposal)
        return proposal, self.proposal_dist.logpdf(self.tempered_posterior), forward

    def sample_stats(self):
        """Statistics of the stage just finished."""
        return {**PopulationKernel.sample_stats(self), "accept_rate": float(np.mean(self.accepted))}
