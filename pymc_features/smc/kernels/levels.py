"""The levels of subset simulation: their tolerances, and the probability of the last."""

import numpy as np

from pymc_features.smc.proposals.mixture import equal_draws

FEWEST = 4  # particles within a tolerance: two for each half
STALLED = (5, 0.01)  # levels in which the way to the tolerance must shorten by this share


class Levels:
    """Tolerances that fall to `epsilon`, each leaving the fraction `p0` of a population.

    Attributes
    ----------
    tolerances : list of float
        Of the levels so far.
    log_probability : float
        Log of P(rho <= last tolerance): the product of the fractions left.
    variance : float
        Squared coefficient of variation of that probability. The fraction of a level varies as the mean over
        its chains does, which accounts for the correlation within each (Au & Beck 2001, Eq. 29); the levels
        are taken for independent.
    """

    def __init__(self, epsilon: float, p0: float):
        self.epsilon, self.p0 = epsilon, p0
        self.tolerances, self.log_probability, self.variance = [], 0.0, 0.0

    def condition(self, log_weights, rng) -> np.ndarray:
        """Positions (n,) of equally weighted draws, from draws of the prior and what else the model says."""
        top = log_weights.max()
        weights = np.exp(log_weights - top) if top > -np.inf else np.zeros(len(log_weights))
        if not weights.sum() ** 2 > 0.1 * len(weights) * (weights @ weights):
            raise ValueError(
                "the model's potentials and other likelihoods must leave room for draws from the prior, got "
                f"{(log_weights > -np.inf).sum()} possible of {len(weights)}, a few of which outweigh the "
                "rest. Put them into the priors, or sample with pmf.sample_smc()."
            )
        mean = weights.mean()
        self.log_probability = float(top + np.log(mean))
        self.variance = float(weights.var() / mean**2 / len(weights))
        return equal_draws(weights / weights.sum(), len(weights), rng)

    @property
    def tolerance(self) -> float:
        """The last tolerance; infinite before the first level."""
        return self.tolerances[-1] if self.tolerances else np.inf

    @property
    def is_last(self) -> bool:
        """Whether the tolerance asked for is reached."""
        return self.tolerance == self.epsilon

    def lower(self, rho, chains) -> np.ndarray:
        """Set the next tolerance; return the positions of the particles within it.

        Parameters
        ----------
        rho : array (n,)
            Discrepancies of the population, infinite where a simulation failed; at least one is not.
        chains : array (n,)
            Number of the Markov chain that each particle belongs to.
        """
        possible = np.sort(rho[np.isfinite(rho)])
        kept = min(int(np.ceil(self.p0 * len(rho))), len(possible))
        reached = possible[kept - 1]
        below = np.searchsorted(possible, self.tolerance)
        if reached == self.tolerance and below >= FEWEST:  # where many share one rho, the next smaller one
            reached = possible[below - 1]
        self.tolerances.append(float(max(reached, self.epsilon)))
        inside = rho <= self.tolerance
        fraction = inside.mean()
        of_chains = np.bincount(chains, inside) / np.bincount(chains)
        self.variance += of_chains.var() / len(of_chains) / fraction**2
        self.log_probability += np.log(fraction)
        return np.flatnonzero(inside)

    @property
    def has_stalled(self) -> bool:
        """Whether the tolerance hardly falls any more, far from where it should go."""
        n_levels, share = STALLED
        if len(self.tolerances) <= n_levels:
            return False
        return self.tolerances[-1 - n_levels] - self.tolerance < share * (self.tolerance - self.epsilon)

    @property
    def progress(self) -> float:
        """An inverse tolerance that is one at the end."""
        return 1.0 if self.is_last else min(self.epsilon / self.tolerance, 1.0 - 1e-9)
