"""Hamiltonian Monte Carlo for many chains at once, after tempering from the prior.

All chains take the same number of leapfrog steps at a time, so that one call evaluates a gradient of each:
several times cheaper than NUTS chain by chain. The target at temperature beta is N(z; 0, I) L(z)^beta.
Tempering resamples between temperatures, so that modes get their weights, and ends with points from the
posterior, where the step is fixed and the chains go on.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

ACCEPTANCE = 0.8
LENGTH = 2.0  # of a trajectory, in standard deviations; drawn between a third of it and all
KEPT = 0.6  # share of effective particles from one temperature to the next
MOVES = 5  # trajectories at each temperature
MAX_STEPS = 100


@dataclass
class Population:
    """Points z (n, d), their log-likelihood (n,) and its gradient (n, d)."""

    z: np.ndarray
    value: np.ndarray
    gradient: np.ndarray

    def chosen(self, index):
        """The points at these positions."""
        return Population(self.z[index], self.value[index], self.gradient[index])


class Trajectories:
    """One Hamiltonian trajectory of every chain, with a step that learns and a metric from the particles."""

    def __init__(self, target, rng):
        self.target, self.rng = target, rng
        self.step = 0.5
        self.factor = np.eye(target.d)

    def fit(self, z):
        """Take the covariance of points (n, d) for the metric."""
        covariance = np.atleast_2d(np.cov(z, rowvar=False))
        shrunk = 0.95 * covariance + 0.05 * np.diag(np.diag(covariance))
        self.factor = np.linalg.cholesky(shrunk)

    def advance(self, now, beta, learn=0.0):
        """Move all chains once; return them and their mean acceptance; `learn`: how fast the step adapts."""
        rng, factor = self.rng, self.factor
        length = LENGTH * rng.uniform(1.0 / 3.0, 1.0)
        step = self.step * rng.uniform(0.8, 1.2)
        n_steps = int(np.clip(np.ceil(length / step), 1, MAX_STEPS))
        momentum = rng.standard_normal(now.z.shape)
        start = self.energy(now.z, now.value, momentum, beta)
        z, value, gradient = now.z, now.value, now.gradient
        momentum = momentum + 0.5 * step * (beta * gradient - z) @ factor
        for i in range(n_steps):
            z = z + step * momentum @ factor.T
            value, gradient = self.target.with_gradient(z)
            momentum = momentum + (0.5 if i == n_steps - 1 else 1.0) * step * (beta * gradient - z) @ factor
        with np.errstate(invalid="ignore", over="ignore"):
            probability = np.exp(np.minimum(start - self.energy(z, value, momentum, beta), 0.0))
        probability = np.nan_to_num(probability)
        moved = rng.random(len(z)) < probability
        mean = probability.mean()
        self.step *= np.exp(learn * (mean - ACCEPTANCE))
        after = Population(
            np.where(moved[:, None], z, now.z),
            np.where(moved, value, now.value),
            np.where(moved[:, None], gradient, now.gradient),
        )
        return after, mean

    @staticmethod
    def energy(z, value, momentum, beta):
        """Minus the log of the joint density (n,)."""
        return 0.5 * (z**2).sum(axis=1) - beta * value + 0.5 * (momentum**2).sum(axis=1)


def effective(log_weights):
    """Kish's effective share of weighted points."""
    w = np.exp(log_weights - log_weights.max())
    return w.sum() ** 2 / (w**2).sum() / len(w)


def next_temperature(value, beta):
    """The temperature that keeps the share `KEPT` of effective particles, at most 1."""
    if effective((1.0 - beta) * value) >= KEPT:
        return 1.0
    low = np.log(1e-6 / np.ptp(value[np.isfinite(value)]))
    log_step = brentq(lambda s: effective(np.exp(s) * value) - KEPT, low, np.log(1.0 - beta), xtol=1e-2)
    return beta + np.exp(log_step)


def systematic(weights, n, rng):
    """Positions (n,) drawn by systematic resampling."""
    cumulative = np.cumsum(weights)
    return np.searchsorted(cumulative / cumulative[-1], (rng.random() + np.arange(n)) / n).clip(
        0, len(weights) - 1
    )


def tempered(target, n, rng):
    """Temper n particles from the prior to the posterior.

    Returns
    -------
    Population, Trajectories, log evidence
    """
    moves = Trajectories(target, rng)
    z = rng.standard_normal((n, target.d))
    now = Population(z, *target.with_gradient(z))
    beta, log_z = 0.0, 0.0
    while beta < 1.0:
        new = next_temperature(now.value, beta)
        log_weights = (new - beta) * now.value
        top = log_weights.max()
        weights = np.exp(log_weights - top)
        log_z += top + np.log(weights.mean())
        beta = new
        now = now.chosen(systematic(weights, n, rng))
        moves.fit(now.z)
        for _ in range(MOVES if beta < 1.0 else 4 * MOVES):
            now, _ = moves.advance(now, beta, learn=0.5)
    return now, moves, log_z


def long_run(now, moves, keep_going):
    """Draws (chain, iteration, d) of the posterior while `keep_going(iteration)` says so, the step fixed."""
    for i in range(30):  # the metric of the posterior, and its step
        if i == 10:
            moves.fit(now.z)
        now, _ = moves.advance(now, 1.0, learn=0.3 if i < 20 else 0.1)
    draws = []
    while keep_going(len(draws)):
        now, _ = moves.advance(now, 1.0)
        draws.append(now.z.astype(np.float32))
    return np.stack(draws, axis=1)
