"""Markov chains of one temperature: they start from the pool, forget where, and then fill it."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from pymc_features.smc.proposals.proposal import moments
from pymc_features.smc.proposals.unbending import fit_to

TARGET = 0.7  # mean acceptance
FIRST_LENGTH, LENGTHS = 2.0, (0.5, 20.0)  # in standard deviations; a Gaussian's best are 1 to 2
SHORTEST = 0.4  # of a trajectory, over the longest
MOST_STEPS = 64
DIVERGED = 1000.0  # range of the energy along a trajectory that is given up
LARGEST_CHANGE = (0.3, 2.0)  # of the step size, in one adaptation
SLOWER = 0.6  # the nth change counts for n to the power of minus this


class Trajectories(NamedTuple):
    """Ends of trajectories (m, ...), and how they got there.

    Attributes
    ----------
    x, velocity, slope : array (m, d)
        End, velocity in whitened coordinates, and gradient of the log target there.
    log_reference, log_ratio : array (m,)
        As of the pool's points; whatever they were last for trajectories that were given up.
    log_moves : array (m,)
        Kinetic energy at the start less that at the end; -inf where the trajectory was given up.
    time : float
    gradients : int
        Evaluated in all.
    """

    x: np.ndarray
    velocity: np.ndarray
    slope: np.ndarray
    log_reference: np.ndarray
    log_ratio: np.ndarray
    log_moves: np.ndarray
    time: float
    gradients: int


class Hamiltonian:
    """Leapfrog trajectories whose step and length are learned from the population.

    Of the density p, in coordinates z = L^-1 (x - c) in which the points of a fit have unit covariance, a
    trajectory follows dz/dt = v, dv/dt = d ln p / dz from a normal v, by n leapfrog steps of size epsilon.
    The steps keep volumes and can be undone, so that its end is accepted with probability

        min(1, exp(H(z, v) - H(z', v'))),     H = v'v / 2 - ln p,

    whatever the gradient that was used: a wrong one costs acceptance, no more (Neal, MCMC using Hamiltonian
    dynamics, 2011). n depends on no chain, and is drawn anew each time lest trajectories close.

    Attributes
    ----------
    step, length : float
        Size of a leapfrog step and longest trajectory, in whitened coordinates. They are kept from one fit to
        the next.
    is_new : bool
        Whether nothing has been learned yet.

    Notes
    -----
    The error of the energy has a variance sigma^2 proportional to epsilon^4, of which 2 Phi(-sigma / 2) are
    accepted (Beskos, Pillai, Roberts, Sanz-Serna & Stuart, Bernoulli 19, 2013): that gives a Newton step of
    ln epsilon, damped as by Robbins & Monro. The length follows the gradient of the ChEES criterion
    E[(|z'|^2 - |z|^2)^2] / 4 (Hoffman, Radul & Sountsov, AISTATS 2021) over the length, for that is what a
    trajectory costs.
    """

    def __init__(self):
        self.step, self.length, self.is_new = None, FIRST_LENGTH, True

    def fit(self, points) -> None:
        """Whiten by the covariance of equally weighted points (n, d)."""
        weights = np.full(len(points), 1.0 / len(points))
        self.centre, self.factor = moments(points, weights, weights)
        self.step = self.step or points.shape[1] ** -0.25
        self.n_learned = 0

    def propose(self, x, slope, log_target, target: Callable, rng: np.random.Generator) -> Trajectories:
        """Follow trajectories from points (m, d) with known gradients (m, d) and log target (m,).

        `target` returns log reference, log ratio, log target and its gradient at points. Trajectories are
        given up that leave the support, or whose energy has a range beyond `DIVERGED`: the way back would be,
        too.
        """
        n_steps = int(np.ceil(self.length * rng.uniform(SHORTEST, 1.0) / self.step))
        n_steps = min(max(n_steps, 1), MOST_STEPS)
        velocity = rng.standard_normal(x.shape)
        kinetic = 0.5 * (velocity**2).sum(axis=1)
        lowest, highest = kinetic - log_target, kinetic - log_target
        y, slope = x.copy(), slope.copy()
        values = np.zeros((2, len(x)))
        alive, gradients = np.arange(len(x)), 0
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(n_steps):
                velocity[alive] += 0.5 * self.step * slope[alive] @ self.factor
                y[alive] += self.step * velocity[alive] @ self.factor.T
                alive = alive[np.isfinite(y[alive]).all(axis=1)]
                if not len(alive):
                    break
                *values[:, alive], log_density, slope[alive] = target(y[alive])
                gradients += len(alive)
                velocity[alive] += 0.5 * self.step * slope[alive] @ self.factor
                energy = 0.5 * (velocity[alive] ** 2).sum(axis=1) - log_density
                lowest[alive] = np.minimum(lowest[alive], energy)
                highest[alive] = np.maximum(highest[alive], energy)
                alive = alive[highest[alive] - lowest[alive] < DIVERGED]  # not if one of them is no number
        log_moves = np.full(len(x), -np.inf)
        log_moves[alive] = kinetic[alive] - 0.5 * (velocity[alive] ** 2).sum(axis=1)
        y[np.isneginf(log_moves)] = x[np.isneginf(log_moves)]
        return Trajectories(y, velocity, slope, *values, log_moves, n_steps * self.step, gradients)

    def learn(self, x, end: Trajectories, probability) -> None:
        """Adapt step and length to trajectories from points (m, d) and their probabilities (m,)."""
        self.n_learned, self.is_new = self.n_learned + 1, False
        gain = self.n_learned**-SLOWER
        accepted = np.clip(probability.mean(), 1e-3, 0.99)
        change = np.clip(np.sqrt(ndtri(0.5 * TARGET) / ndtri(0.5 * accepted)), *LARGEST_CHANGE)
        self.step = float(self.step * change**gain)
        whitened = [np.linalg.solve(self.factor, (points - self.centre).T).T for points in (x, end.x)]
        before, after = ((z**2).sum(axis=1) for z in whitened)
        difference = np.where(probability > 0, after - before, 0.0)
        criterion = probability @ difference**2
        if accepted > 0.1 and criterion > 0:
            outward = np.where(probability > 0, (whitened[1] * end.velocity).sum(axis=1), 0.0)
            # d ln criterion / d ln time: 2 for short trajectories, 0 at the longest jump, 1 at that per cost
            slope = 4.0 * end.time * (probability * difference @ outward) / criterion - 1.0
            length = self.length * np.exp(0.25 * gain * np.clip(slope, -2.0, 2.0))
            self.length = float(np.clip(length, *LENGTHS))


# --- hamiltonian trajectories -------------------------------------------------------------------------------


# scale of the moves of the proposal: independent, or t-preconditioned Crank-Nicolson steps
SCALES = {"independent": 1.0, "half": 0.5, "fifth": 0.2}
DIFFERENCES = ("unbent_difference", "difference")
SIMPLE = (*SCALES, *DIFFERENCES)  # of one value for each chain
ARMS = (*SIMPLE, "hamiltonian")
HAMILTONIAN = len(SIMPLE)
LEAST_SHARE = 0.08  # of each move: one that fails on average may be the only one for a few points
FIRST_SHARES = (0.4, 0.1, 0.1, 0.25, 0.15, 0.0)
# of a gradient over that of a value, a constant lest results depend on a clock: 2.4 to 3.7 are measured
# (`python -m benchmarks --only gradients`). With 8 four structural posteriors took the same CPU within 14 %
GRADIENT_COST = 3.0
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
        (n, d), mapping, ratio = x.shape, self.proposal.map, 0.0
        a, b = rng.integers(len(self.points), size=(2, n))
        length = (2.38 / np.sqrt(2.0 * d) * np.exp(0.7 * rng.standard_normal(n)))[:, None]
        if ARMS[arm] == "difference" or mapping is None:
            y = x + length * (self.points[a] - self.points[b])
        else:
            with np.errstate(over="ignore", invalid="ignore"):
                z, log_jacobian = mapping.forward(x)
                y = mapping.inverse(z + length * (self.unbent[a] - self.unbent[b]))
                y = np.where(np.isfinite(y).all(axis=1)[:, None], y, x)
                ratio = log_jacobian - mapping.forward(y)[1]
        return y, self.proposal.log_density(y), ratio

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


FIRST_CHECK, CHECK_EVERY = 3, 3  # steps
MAX_BURN_IN = 150
FORGOTTEN = 0.03  # mean correlation with the start, beyond what as many independent chains show by chance
SLOWEST = 3.5  # largest correlation, in standard deviations of one by chance
TAILS = (0.005, 0.995)  # statistics are clipped there before their autocorrelation is measured
CAUTIOUS = 0.8  # quantile of the autocorrelation times of all statistics
ON_TRIAL = (16, 8)  # chains that trajectories are tried on: at least, and one in so many
USABLE, FIRST_TRIALS = (0.3, 0.95), 4  # acceptance at which the first step size will do, and trials for that


class Chains:
    """Chains that leave one density of a pool invariant.

    Parameters
    ----------
    pool : Pool
    position : array of int (m,)
        Points of the pool to start from.
    moves : FittedMoves
    beta : float
        Temperature.
    weigh : callable
        Log reference and log ratio, each (m,), of points (m, d).
    rng : Generator
    slopes : callable, optional
        Log reference and log ratio, each (m,), and the gradients of both (m, d), of points (m, d), for
        Hamiltonian trajectories; for a model that has them.

    Attributes
    ----------
    n_steps, n_hamiltonian : int
        Steps so far, and those of them by trajectories.
    acceptances : list of float
        Mean probability of each step.
    """

    def __init__(self, pool, position, moves, beta, weigh, rng, slopes=None):
        self.pool, self.moves, self.beta, self.weigh, self.rng = pool, moves, beta, weigh, rng
        self.slopes = slopes
        self.x = pool.particles[position]
        self.log_reference, self.log_ratio = pool.log_reference[position], pool.log_ratio[position]
        self.density = moves.proposal.log_density(self.x)
        self.position = None  # in the pool, once states are kept
        self.n_steps = self.n_hamiltonian = 0
        self.slope = np.full(self.x.shape, np.nan)  # gradients of the log target, where they are known
        self.acceptances, self.states = [], []
        self.first_ranks = ranks(self.statistics())

    def statistics(self) -> np.ndarray:
        """What the chains are judged by (m, d + 1): unbent coordinates and the log ratio."""
        return np.column_stack([self.moves.coordinates(self.x), self.log_ratio])

    def step(self) -> None:
        """One Metropolis-Hastings step of all chains."""
        arm = self.moves.choose(self.rng)
        probability = self.follow(np.arange(len(self.x))) if arm == HAMILTONIAN else self.move(arm)
        self.acceptances.append(probability.mean())
        self.n_steps += 1
        self.n_hamiltonian += arm == HAMILTONIAN
        if self.position is not None:
            self.states.append(self.statistics())

    def move(self, arm: int) -> np.ndarray:
        """Step by one of the simple moves; return the probabilities of acceptance (m,)."""
        y, density, log_moves = self.moves.propose(arm, self.x, self.density, self.rng)
        values = (*self.weigh(y), density)
        probability = self.probability(*values[:2], log_moves)
        if self.position is None:
            self.moves.learn(arm, self.x, y, probability)
        self.accept(y, values, probability, np.full_like(y, np.nan))
        return probability

    def follow(self, rows) -> np.ndarray:
        """Step by trajectories of some chains, of all if states are kept; probabilities of all (m,)."""
        unknown = rows[np.isnan(self.slope[rows]).any(axis=1)]
        if len(unknown):
            self.slope[unknown] = self.target(self.x[unknown])[-1]
        log_target = (self.log_reference + self.beta * self.log_ratio)[rows]
        hamiltonian = self.moves.hamiltonian
        end = hamiltonian.propose(self.x[rows], self.slope[rows], log_target, self.target, self.rng)
        y, slope, log_moves = self.x.copy(), self.slope.copy(), np.full(len(self.x), -np.inf)
        y[rows], slope[rows], log_moves[rows] = end.x, end.slope, end.log_moves
        values = np.array([self.log_reference, self.log_ratio, self.density])
        values[:, rows] = end.log_reference, end.log_ratio, self.moves.proposal.log_density(end.x)
        probability = self.probability(*values[:2], log_moves)
        if self.position is None:
            cost = (end.gradients + len(unknown)) / len(rows)
            self.moves.learn(HAMILTONIAN, self.x[rows], end.x, probability[rows], cost)
            hamiltonian.learn(self.x[rows], end, probability[rows])
        self.accept(y, values, probability, slope)
        return probability

    def target(self, x):
        """Log reference, log ratio, log target, each (n,), and the gradient of the last (n, d), of points."""
        log_reference, log_ratio, of_reference, of_ratio = self.slopes(x)
        log_target = log_reference + self.beta * log_ratio
        return log_reference, log_ratio, log_target, of_reference + self.beta * of_ratio

    def probability(self, log_reference, log_ratio, log_moves) -> np.ndarray:
        """Probability of accepting proposals (m,)."""
        with np.errstate(invalid="ignore"):
            log_target = log_reference - self.log_reference + self.beta * (log_ratio - self.log_ratio)
            probability = np.exp(np.minimum(log_target + log_moves, 0.0))
        return np.where(np.isfinite(probability), probability, 0.0)

    def accept(self, y, values, probability, slope) -> None:
        """Go to proposals with these probabilities, and keep both; `values` is what belongs to `y`."""
        moved = self.rng.random(len(y)) < probability
        if self.position is not None:
            self.keep(y, *values[:2], probability, moved)
        self.x, self.slope = np.where(moved[:, None], [y, slope], [self.x, self.slope])
        self.log_reference, self.log_ratio, self.density = np.where(
            moved, values, [self.log_reference, self.log_ratio, self.density]
        )

    def keep(self, y, log_reference, log_ratio, probability, moved) -> None:
        """Put proposals into the pool with their probabilities, and leave the rest where the chains are."""
        np.add.at(self.pool.visits, self.position, 1.0 - probability)
        possible = np.flatnonzero(probability > 0)
        columns = (y, log_reference, log_ratio, probability, np.arange(len(y)))
        ahead = self.position.copy()
        ahead[possible] = self.pool.add(*(values[possible] for values in columns), self.source)
        self.position = np.where(moved, ahead, self.position)

    def forget(self, of_trajectories: float = 0.0) -> None:
        """Step until the chains are no longer correlated with where they started; then begin to keep.

        Trajectories have the share `of_trajectories` at least, if there are gradients.
        """
        share = 0.0 if self.slopes is None else of_trajectories
        while self.n_steps < MAX_BURN_IN:
            self.step()
            if self.n_steps >= FIRST_CHECK and self.n_steps % CHECK_EVERY == 0:
                correlation = 12.0 * (self.first_ranks * ranks(self.statistics())).mean(axis=0)
                chance = 1.0 / np.sqrt(len(self.x))
                mean = np.abs(correlation).mean() - np.sqrt(2.0 / np.pi) * 1.3 * chance
                if mean < FORGOTTEN and correlation.max() < SLOWEST * chance:
                    break
                if self.slopes is not None:
                    self.consider_trajectories(share)
        self.first = len(self.pool.visits)
        self.source = max(s for s, beta in enumerate(self.pool.betas) if beta == self.beta)
        rows = (self.x, self.log_reference, self.log_ratio, np.zeros(len(self.x)), np.arange(len(self.x)))
        self.position = self.pool.add(*rows, self.source)
        self.moves.adapt(share)

    def consider_trajectories(self, share: float) -> None:
        """Try them on some of the chains where the other moves do badly, or they are to have a share.

        They are drawn if they are better, and with this share at least.
        """
        moves = self.moves
        if moves.wants_trial or (share and not moves.tried[HAMILTONIAN]):
            least, one_in = ON_TRIAL
            rows = np.arange(min(len(self.x), max(least, len(self.x) // one_in)))
            for _ in range(FIRST_TRIALS if moves.hamiltonian.is_new else 1):
                probability = self.follow(rows)[rows]
                if USABLE[0] < probability.mean() < USABLE[1]:
                    break
        if moves.tried[HAMILTONIAN] or moves.shares[HAMILTONIAN]:
            moves.adapt(share)

    def measure(self) -> float:
        """Steps that count for one independent draw; the pool is told."""
        states = np.array(self.states)  # (step, chain, statistic): of a few hundred chains
        n, inflation = len(states), 2.0
        if n >= 3:
            low, high = np.quantile(states, TAILS, axis=(0, 1))
            states = np.clip(states, low, high)
            between, total = n * states.mean(axis=0).var(axis=0, ddof=1), states.var(axis=(0, 1))
            times = between[total > 0] / total[total > 0]
            inflation = float(max(1.0, np.quantile(times, CAUTIOUS))) if len(times) else 1.0
            if n < 20:  # short chains cannot show a memory longer than themselves
                inflation = max(inflation, min(n, 4))
        own = self.pool.source[self.first :] == self.source
        self.pool.inflation[self.first :][own] = inflation
        return inflation


def ranks(values) -> np.ndarray:
    """Ranks of each column (n, k), from -1/2 to 1/2."""
    return values.argsort(axis=0).argsort(axis=0) / len(values) - 0.5
