"""Weights and evidences of samples from several temperatures, all used together.

Points theta_i with log-likelihoods l_i were drawn from p_s proportional to prior L^beta_s, n_s of them at
each temperature s = 0 (the prior) ... t. Taken as one sample from the mixture sum_s (n_s / n) p_s, they
represent any temperature beta with the weights

    w_i(beta) = exp(beta l_i) / sum_s (n_s / n) exp(beta_s l_i) / Z_s,      Z(beta) = (1/n) sum_i w_i(beta)

(deterministic mixture, balance heuristic). The evidences of the temperatures are those that satisfy Z_s =
Z(beta_s) for all s: the multistate Bennett acceptance ratio (Shirts & Chodera, J. Chem. Phys. 129, 124105,
2008), which has the smallest variance of all estimators that use these points. Only log-likelihoods enter,
and a constant added to all of them changes no weight.

Points carry masses m_i: what a Markov chain visits twice has mass two; of a step that is accepted with
probability a, the proposal gets a and the state it started from 1 - a, so that rejected proposals count as
well.
"""

import numpy as np
from scipy.optimize import brentq

SMALLEST_BETA = 1e-300
TOLERANCE = 1e-7  # of the log evidences
MAX_ITERATIONS = 50
GROUPS = 20  # of the jackknife; numbers of draws and chains are multiples of it, so that all are equal


class Pool:
    """Everything evaluated so far, and the temperatures it came from.

    Attributes
    ----------
    particles : array (n, d)
    log_prior, log_likelihood, mass, inflation, group : array (n,)
        Points with finite log-likelihood. `inflation`: how many steps of the chain count for one
        independent one. `group`: points of one Markov chain share it, modulo `GROUPS`.
    impossible : array (GROUPS,)
        Prior draws without likelihood, by group.
    betas, log_z, counts : list
        Of each temperature; `counts` includes prior draws without likelihood.
    """

    def __init__(self, particles, log_prior, log_likelihood):
        self.betas, self.log_z, self.counts = [0.0], [0.0], [float(len(particles))]
        possible = log_prior + log_likelihood > -np.inf
        self._size, self._columns = 0, [None] * 6
        group = np.flatnonzero(possible)
        ones = np.ones(len(group))
        self._append(particles[possible], log_prior[possible], log_likelihood[possible], ones, 1.0, group)
        self.impossible = np.bincount(np.flatnonzero(~possible) % GROUPS, minlength=GROUPS)

    def add_prior(self, other: "Pool"):
        """Take in more draws from the prior."""
        self.counts[0] += other.counts[0]
        self.impossible += other.impossible
        self._append(other.particles, other.log_prior, other.log_likelihood, other.mass, 1.0, other.group)

    def add_temperature(self, beta: float, log_z: float):
        """Begin a temperature with an evidence known from the points so far."""
        self.betas.append(beta)
        self.log_z.append(log_z)
        self.counts.append(0.0)

    def add(self, particles, log_prior, log_likelihood, mass, inflation, group) -> np.ndarray:
        """Take in points of the last temperature; return their positions."""
        first = len(self.mass)
        self._append(particles, log_prior, log_likelihood, mass, inflation, group)
        return np.arange(first, len(self.mass))

    def _append(self, particles, log_prior, log_likelihood, mass, inflation, group):
        """Add rows; the columns grow by half, so that many small additions cost no more than their sum."""
        first, self._size = self._size, self._size + len(mass)
        rows = (particles, log_prior, log_likelihood, mass, np.broadcast_to(inflation, len(mass)), group)
        for i, row in enumerate(rows):
            column = self._columns[i]
            if column is None or len(column) < self._size:
                grown = np.empty((self._size + self._size // 2, *row.shape[1:]), dtype=row.dtype)
                if column is not None:
                    grown[:first] = column[:first]
                self._columns[i] = column = grown
            column[first : self._size] = row

    particles, log_prior, log_likelihood, mass, inflation, group = (
        property(lambda self, i=i: self._columns[i][: self._size]) for i in range(6)
    )

    def log_mixture(self) -> np.ndarray:
        """ln sum_s (n_s / n) exp(beta_s l_i) / Z_s, shape (n,)."""
        counts = np.array(self.counts)
        used = counts > 0
        offsets = np.log(counts[used] / counts.sum()) - np.array(self.log_z)[used]
        return log_sum(np.multiply.outer(np.array(self.betas)[used], self.log_likelihood) + offsets[:, None])

    def log_weights(self, beta: float, log_mixture=None) -> np.ndarray:
        """ln w_i(beta), shape (n,)."""
        return beta * self.log_likelihood - (self.log_mixture() if log_mixture is None else log_mixture)

    def normalised(self, log_weights) -> np.ndarray:
        """Share of each point (n,) in a temperature: mass times weight."""
        shares = self.mass * np.exp(log_weights - log_weights.max())
        return shares / shares.sum()

    def log_evidence(self, log_weights) -> float:
        """ln Z from the weights of a temperature."""
        # not SciPy's logsumexp: where ArviZ is loaded and JAX installed, it imports JAX
        top = log_weights.max()
        return float(top + np.log(self.mass @ np.exp(log_weights - top)) - np.log(sum(self.counts)))

    def effective(self, log_weights) -> float:
        """Effective number of independent points behind weights (Kish), serial correlation included."""
        w = np.exp(log_weights - log_weights.max())
        spread = self.inflation * self.mass * np.maximum(self.mass, 1.0) * w**2
        return float((self.mass @ w) ** 2 / spread.sum())

    def solve(self):
        """Make the evidences of all temperatures agree with each other."""
        counts = np.array(self.counts)
        used = np.flatnonzero(counts > 0)
        log_z = np.array(self.log_z)
        log_z[used] = bennett(
            np.array(self.betas)[used], log_z[used], counts[used], self.log_likelihood, self.mass
        )
        self.log_z = list(log_z)

    def standard_error(self) -> float:
        """Standard error of the last log evidence: jackknife over groups of whole Markov chains."""
        betas, log_z, counts = np.array(self.betas), np.array(self.log_z), np.array(self.counts)
        p, _ = origins(betas, log_z, counts, self.log_likelihood)
        values = []
        for group in range(GROUPS):  # without a group, one step of Newton's method away
            kept = self.group % GROUPS != group
            removed = self.mass[~kept].sum() + self.impossible[group]
            counts_kept = (1.0 - removed / counts.sum()) * counts
            values.append(newton_step(p[:, kept], self.mass[kept], counts_kept)[-1])
        return float(np.sqrt((GROUPS - 1) * np.var(values)))


def log_sum(terms: np.ndarray) -> np.ndarray:
    """ln sum exp over the first axis, without SciPy's overhead."""
    top = terms.max(axis=0)
    return top + np.log(np.exp(terms - top).sum(axis=0))


def origins(betas, log_z, counts, log_likelihood):
    """Probabilities (t, n) that a point comes from each temperature, and ln sum_s n_s L^beta_s / Z_s (n,)."""
    terms = np.multiply.outer(betas, log_likelihood) + (np.log(counts) - log_z)[:, None]
    top = terms.max(axis=0)
    p = np.exp(terms - top)
    total = p.sum(axis=0)
    return p / total, top + np.log(total)


def newton_step(p, mass, counts):
    """Step of the log evidences (t,) but the first, which is zero."""
    weighted = p * mass
    expected = weighted.sum(axis=1)
    hessian = np.diag(expected) - weighted @ p.T
    step = np.zeros(len(counts))
    step[1:] = np.linalg.lstsq(hessian[1:, 1:], (counts - expected)[1:], rcond=1e-12)[0]
    return step


def bennett(betas, log_z, counts, log_likelihood, mass) -> np.ndarray:
    """Self-consistent log evidences (t,), Z = 1 at beta = 0, from a first guess; see the module.

    Newton's method on the convex function sum_i m_i ln sum_s n_s L_i^beta_s / Z_s + sum_s n_s ln Z_s.
    """
    log_z = np.array(log_z, dtype=float)
    p, log_total = origins(betas, log_z, counts, log_likelihood)
    value = mass @ log_total + counts @ log_z
    for _ in range(MAX_ITERATIONS):
        step = newton_step(p, mass, counts)
        while True:  # a shorter step where the full one overshoots
            trial = log_z - step
            p, log_total = origins(betas, trial, counts, log_likelihood)
            trial_value = mass @ log_total + counts @ trial
            if trial_value <= value + 1e-9 * abs(value) or np.abs(step).max() < TOLERANCE:
                break
            step *= 0.5
        log_z, value = trial, trial_value
        if np.abs(step).max() < TOLERANCE:
            break
    return log_z


def next_beta(pool: Pool, beta: float, target: float) -> float:
    """Largest temperature up to 1 whose weights keep the effective number `target`, found on a log scale.

    Where even a vanishing increase leaves fewer, as with likelihoods that are zero over most of the prior,
    nine tenths of what is left are kept; a likelihood that is constant where it is not zero leads to 1 at
    once.
    """
    log_mixture = pool.log_mixture()

    def effective(b):
        return pool.effective(pool.log_weights(b, log_mixture))

    target = min(target, 0.9 * effective(max(beta, SMALLEST_BETA)))
    if effective(1.0) >= target:
        return 1.0
    spread = np.ptp(pool.log_likelihood)
    if spread == 0.0:
        return 1.0
    low = np.log(1e-3 / spread)  # increases smaller than this change no weight by more than 0.1 %
    high = np.log1p(-beta) if beta > 0 else 0.0
    if effective(beta + np.exp(low)) < target:
        return beta + np.exp(low)
    increase = brentq(lambda x: effective(beta + np.exp(x)) - target, low, high, xtol=1e-3)
    return float(beta + np.exp(increase))


def equal_draws(weights, n: int, rng: np.random.Generator) -> np.ndarray:
    """Positions (n,) of equally weighted draws, in random order: systematic resampling."""
    uniform = (rng.random() + np.arange(n)) / n
    chosen = np.searchsorted(np.cumsum(weights), uniform).clip(max=len(weights) - 1)
    rng.shuffle(chosen)
    return chosen
