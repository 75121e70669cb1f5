"""Sequential Monte Carlo from the posterior of the events before to that of one more."""

from typing import Unpack

import numpy as np

from pymc_features.events.sequence.density import FittedDensity
from pymc_features.smc import PersistentSMC
from pymc_features.smc.kernels.base import KernelOptions


class ContinuedSMC(PersistentSMC):
    """`PersistentSMC` whose prior is another one than the model's.

    With a share c of the model's own prior pi, lest a structure that has changed be looked for where it was,

        pi_e(theta) = (1 - c) q(theta) + c pi(theta).

    Parameters
    ----------
    before : FittedDensity
        q, what is known from the events before.
    share : float
        c.
    """

    def __init__(
        self, draws: int = 2000, *, before: FittedDensity, share: float, **kwargs: Unpack[KernelOptions]
    ):
        super().__init__(draws, **kwargs)
        self.before, self.share = before, share

    def evaluate(self, particles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log prior and log-likelihood, each (p,), of particles (p, d); counts evaluations and failures."""
        prior, likelihood = super().evaluate(particles)
        known = np.log1p(-self.share) + self.before.log_density(particles)
        mixed = np.logaddexp(known, np.log(self.share) + prior)
        return np.where(prior > -np.inf, mixed, -np.inf), likelihood

    def initial_particles(self, n: int) -> np.ndarray:
        """Draws (n, d) from this prior."""
        n_own = self.rng.binomial(n, self.share)
        known = self.before.draw(n - n_own, self.rng)
        particles = np.concatenate([known, super().initial_particles(n_own)]) if n_own else known
        return particles[self.rng.permutation(n)]
