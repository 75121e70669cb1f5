"""Moves of Markov chains behind a fitted proposal, drawn as often as they have been seen to pay."""

import numpy as np

from pymc_features.smc.proposals.fitted import fit_to
from pymc_features.smc.proposals.hamiltonian import Hamiltonian

# scale of the moves of the proposal: independent, or t-preconditioned Crank-Nicolson steps
SCALES = {"independent": 1.0, "half": 0.5, "fifth": 0.2}
DIFFERENCES = ("unbent_difference", "difference")
SIMPLE = (*SCALES, *DIFFERENCES)  # of one value for each chain
ARMS = (*SIMPLE, "hamiltonian")
HAMILTONIAN = len(SIMPLE)
LEAST_SHARE = 0.08  # of each move: one that fails on average may be the only one for a few points
FIRST_SHARES = (0.4, 0.1, 0.1, 0.25, 0.15, 0.0)
# of a gradient over that of a value, a constant lest results depend on a clock: measured were 6 to 9 for a
# chain of 10 degrees of freedom, 3 to 4 for one of 40 (benchmarks)
GRADIENT_COST = 8.0
# squared distance per cost that trajectories may reach: 2 for an accepted draw, of three steps at least
BEST_OF_GRADIENTS = 2.0 / (3.0 * GRADIENT_COST)
LEAST_TUNED, MOST_UNTUNED = 0.3, 4  # acceptance that says so, and trajectories until it does in any case
FORGETTING = 1.5  # by which this is remembered higher than it was, in each stage


class FittedMoves:
    """Proposals from a fit to the points of a stage.

    Independent draws from the fit; shorter moves that leave it invariant (Grumitt, Karamanis & Seljak, 2024);
    steps along the difference of two points of the fit (differential evolution, ter Braak 2006), in the
    unbent coordinates and in the plain ones; for models with gradients, Hamiltonian trajectories. A step
    draws one kind for all chains. Its probability is in proportion to the squared distance, in unbent
    coordinates, by which it moved the chains of the stage until their states are kept, per cost.
    Trajectories, each as dear as many values, are drawn only where no other kind moves the chains further for
    that.

    Parameters
    ----------
    bounded : array of bool (d,), optional
        Parameters of which the logits are given.

    Attributes
    ----------
    proposal : FittedProposal
    hamiltonian : Hamiltonian
    shares : array
        Probabilities of `ARMS`.
    """

    def __init__(self, bounded=None):
        self.bounded = bounded
        self.shares = np.array(FIRST_SHARES)
        self.hamiltonian, self.remembered = Hamiltonian(), BEST_OF_GRADIENTS

    def fit(self, points, rng: np.random.Generator) -> None:
        """Fit to equally weighted points (n, d), which may hold the same one many times."""
        self.proposal = fit_to(points, rng, self.bounded)
        self.hamiltonian.fit(points)
        self.points = points
        self.unbent = self.coordinates(points)
        self.spread = self.unbent.std(axis=0)
        self.distance, self.tried, self.cost = np.zeros((3, len(ARMS)))
        self.remembered = min(FORGETTING * self.remembered, BEST_OF_GRADIENTS)

    def coordinates(self, x):
        """Unbent coordinates (n, d), or the plain ones if there is no map."""
        return x if self.proposal.map is None else self.proposal.map.forward(x)[0]

    def choose(self, rng: np.random.Generator) -> int:
        """Draw the number of a move."""
        return rng.choice(len(ARMS), p=self.shares)

    def propose(self, arm: int, x, density, rng):
        """Return points (n, d), their density (n,), and the log ratio of the moves, for one of `SIMPLE`.

        `density` is that of the proposal at x. The ratio is that of the densities of the ways back and forth.
        """
        if ARMS[arm] in SCALES:
            y = self.proposal.move(x, SCALES[ARMS[arm]], rng)
            new_density = self.proposal.log_density(y)
            return y, new_density, density - new_density
        n, d = x.shape
        a, b = rng.integers(len(self.points), size=(2, n))
        length = (2.38 / np.sqrt(2.0 * d) * np.exp(0.7 * rng.standard_normal(n)))[:, None]
        mapping = self.proposal.map
        if ARMS[arm] == "difference" or mapping is None:
            y = x + length * (self.points[a] - self.points[b])
            return y, self.proposal.log_density(y), 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            z, log_jacobian = mapping.forward(x)
            y = mapping.inverse(z + length * (self.unbent[a] - self.unbent[b]))
            y = np.where(np.isfinite(y).all(axis=1)[:, None], y, x)
            return y, self.proposal.log_density(y), log_jacobian - mapping.forward(y)[1]

    def learn(self, arm: int, x, y, probability, gradients: float = 0.0) -> None:
        """Note how far a move went on average, with so many gradients for each chain or with one value."""
        with np.errstate(over="ignore", invalid="ignore"):
            step = (self.coordinates(y) - self.coordinates(x)) / np.maximum(self.spread, 1e-300)
        squares = np.where(probability > 0, np.minimum((step**2).mean(axis=1), 9.0), 0.0)
        self.distance[arm] += squares @ probability / len(x)
        self.tried[arm] += 1.0
        self.cost[arm] += GRADIENT_COST * gradients or 1.0
        if arm == HAMILTONIAN and (probability.mean() > LEAST_TUNED or self.tried[arm] >= MOST_UNTUNED):
            self.remembered = self.distance[arm] / self.cost[arm]

    @property
    def best(self) -> float:
        """Squared distance for the cost of a value, of the best of the simple moves."""
        return float((self.distance / np.maximum(self.cost, 1.0))[:HAMILTONIAN].max())

    @property
    def wants_trial(self) -> bool:
        """Whether trajectories have not been tried since the fit, and may be better than what was."""
        return bool(self.tried[0]) and not self.tried[HAMILTONIAN] and self.best < self.remembered

    def adapt(self, of_trajectories: float = 0.0) -> None:
        """Draw moves in proportion to what they achieved, trajectories with this probability at least.

        Without one if they have never been tried.
        """
        mean = (self.distance + 0.1) / (self.tried + 0.5)
        mean[HAMILTONIAN] = 0.0
        if (self.tried[HAMILTONIAN] or self.shares[HAMILTONIAN]) and self.remembered > self.best:
            mean = self.distance / np.maximum(self.cost, 1.0)
            mean[HAMILTONIAN] = self.remembered
        self.shares = (1.0 - LEAST_SHARE * len(SIMPLE)) * mean / mean.sum()
        self.shares[:HAMILTONIAN] += LEAST_SHARE
        if self.shares[HAMILTONIAN] < of_trajectories and not self.hamiltonian.is_new:
            self.shares *= (1.0 - of_trajectories) / (1.0 - self.shares[HAMILTONIAN])
            self.shares[HAMILTONIAN] = of_trajectories
