"""Moves of a population that adapt themselves: a fitted mixture, and steps of differential evolution."""

import numpy as np

from pymc_features.smc.proposals.proposal import distinct, fit_mixture

# At a hard edge, or with a noisy simulator, short moves are hardly accepted more often than long ones: 0.35
# made up to six times as many simulations, or was out of reach at any length
TARGET_AT_AN_EDGE = 0.1
# What a fitted mixture misses grows with the dimension: from two to eleven parameters the share of local
# proposals rises, and the expected correlation with its first points falls below which a stage may end
LOCAL_SHARES = (0.2, 0.5)
FORGOTTEN = (0.1, 0.001)


class AdaptiveMoves:
    """Proposals of a Markov chain, as long as their acceptance allows.

    Most are moves of a mixture fitted to points of the target (`StudentMixture.move`): independent of the
    present point at a `scale` of one, shortened towards it (t-preconditioned Crank-Nicolson, a conditional
    move) below. Some are steps along the difference of two of the points (differential evolution,
    ter Braak 2006): of the right size even in a corner of the target that holds too few points for the
    mixture to see it.

    Parameters
    ----------
    n_parameters : int
        Dimension of the points.

    Attributes
    ----------
    scale : float
        Length of the mixture's moves, up to 1; kept from stage to stage.
    memory : float
        Expected correlation with the points at which the stage began.
    n_steps : int
        Steps of the stage.
    """

    def __init__(self, n_parameters: int):
        rise = float(np.clip((n_parameters - 2) / 9.0, 0.0, 1.0))
        self.local_share = LOCAL_SHARES[0] + rise * (LOCAL_SHARES[1] - LOCAL_SHARES[0])
        self.forgotten = FORGOTTEN[0] * (FORGOTTEN[1] / FORGOTTEN[0]) ** rise
        self.scale, self.memory, self.n_steps = 1.0, 1.0, 0

    def fit(self, points, rng: np.random.Generator):
        """Begin a stage: fit to equally weighted points (n, d) of its target."""
        self.mixture = fit_mixture(*distinct(points), rng)
        self.points = points
        self.memory, self.n_steps = 1.0, 0

    @property
    def kept(self) -> float:
        """Share of its distance from the centre that a moved point keeps."""
        return np.sqrt(1.0 - self.scale**2)

    def propose(self, x, rng: np.random.Generator):
        """Return proposals (n, d), and which of them (n,) are local and hence symmetric."""
        n, d = x.shape
        proposal = self.mixture.move(x, self.scale, rng)
        a, b = rng.integers(len(self.points), size=(2, n))
        step = self.points[a] - self.points[b]
        local = (rng.random(n) < self.local_share) & step.any(axis=1)
        length = 2.38 / np.sqrt(2.0 * d) * np.exp(0.7 * rng.standard_normal(n))
        return np.where(local[:, None], x + length[:, None] * step, proposal), local

    def learn(self, acceptance: float):
        """After a step: forget, and shorten moves that are rarely accepted, lengthen them otherwise."""
        self.n_steps += 1
        self.memory *= 1.0 - (1.0 - self.local_share) * acceptance * (1.0 - self.kept)
        gain = 1.0 / np.sqrt(1.0 + 0.1 * self.n_steps)
        self.scale = float(np.clip(self.scale * np.exp(gain * (acceptance - TARGET_AT_AN_EDGE)), 1e-3, 1.0))

    @property
    def has_forgotten(self) -> bool:
        """Whether little of the stage's first points is left."""
        return self.memory <= self.forgotten


class CrossedMoves:
    """Two `AdaptiveMoves`, each fitted to the points that the other one moves.

    Moves fitted to the very points they start from fit them too well: few of them lead away, and a population
    keeps the errors of its seeds. Even rows belong to one half, odd rows to the other.
    """

    def __init__(self, n_parameters: int):
        self.halves = [AdaptiveMoves(n_parameters) for _ in range(2)]

    def fit(self, points, rng):
        """Begin a stage from equally weighted points (n, d)."""
        for k, moves in enumerate(self.halves):
            moves.fit(points[1 - k :: 2], rng)

    def log_density(self, x):
        """Log-density (n,) of each point's mixture."""
        density = np.empty(len(x))
        for k, moves in enumerate(self.halves):
            density[k::2] = moves.mixture.log_density(x[k::2])
        return density

    def propose(self, x, rng):
        """Return proposals (n, d), and which of them (n,) are local and hence symmetric."""
        proposal, local = np.empty_like(x), np.empty(len(x), dtype=bool)
        for k, moves in enumerate(self.halves):
            proposal[k::2], local[k::2] = moves.propose(x[k::2], rng)
        return proposal, local

    def learn(self, moved):
        """After a step, from which points moved (n,)."""
        for k, moves in enumerate(self.halves):
            moves.learn(moved[k::2].mean())

    @property
    def n_steps(self) -> int:
        """Steps of the stage."""
        return self.halves[0].n_steps

    @property
    def scale(self) -> float:
        """Mean length of the mixtures' moves."""
        return float(np.mean([moves.scale for moves in self.halves]))

    @property
    def has_forgotten(self) -> bool:
        """Whether little of the stage's first points is left in either half."""
        return all(moves.has_forgotten for moves in self.halves)
