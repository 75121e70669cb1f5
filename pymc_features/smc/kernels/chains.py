"""Markov chains of one temperature: they start from the pool, forget where, and then fill it."""

import numpy as np

from pymc_features.smc.proposals.arms import HAMILTONIAN

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
    n_steps, n_kept : int
        Steps so far, and those of them whose states are in the pool.
    n_hamiltonian : int
        Steps by trajectories.
    inflation : float
        Steps that count for one independent draw, measured.
    """

    def __init__(self, pool, position, moves, beta, weigh, rng, slopes=None):
        self.pool, self.moves, self.beta, self.weigh, self.rng = pool, moves, beta, weigh, rng
        self.slopes = slopes
        self.x = pool.particles[position]
        self.log_reference, self.log_ratio = pool.log_reference[position], pool.log_ratio[position]
        self.density = moves.proposal.log_density(self.x)
        self.position = None  # in the pool, once states are kept
        self.n_steps = self.n_kept = self.n_hamiltonian = 0
        self.slope = np.full(self.x.shape, np.nan)  # gradients of the log target, where they are known
        self.acceptances, self.states, self.inflation = [], [], 1.0
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
            self.n_kept += 1
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

    def measure(self) -> None:
        """Say in the pool how many steps count for one independent draw."""
        states = np.array(self.states)  # (step, chain, statistic): of a few hundred chains
        n = len(states)
        if n < 3:
            self.inflation = 2.0
        else:
            low, high = np.quantile(states, TAILS, axis=(0, 1))
            states = np.clip(states, low, high)
            between, total = n * states.mean(axis=0).var(axis=0, ddof=1), states.var(axis=(0, 1))
            times = between[total > 0] / total[total > 0]
            self.inflation = float(max(1.0, np.quantile(times, CAUTIOUS))) if len(times) else 1.0
            if n < 20:  # short chains cannot show a memory longer than themselves
                self.inflation = max(self.inflation, min(n, 4))
        own = self.pool.source[self.first :] == self.source
        self.pool.inflation[self.first :][own] = self.inflation


def ranks(values) -> np.ndarray:
    """Ranks of each column (n, k), from -1/2 to 1/2."""
    return values.argsort(axis=0).argsort(axis=0) / len(values) - 0.5
