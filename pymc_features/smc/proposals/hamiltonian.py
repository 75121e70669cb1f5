"""Hamiltonian trajectories of a population of Markov chains, all of the same number of steps.

Of the density p, in coordinates z = L^-1 (x - c) in which the points of a fit have unit covariance, a
trajectory follows dz/dt = v, dv/dt = d ln p / dz from a normal v, by n leapfrog steps of size epsilon. The
steps keep volumes and can be undone, so that its end is accepted with probability

    min(1, exp(H(z, v) - H(z', v'))),     H = v'v / 2 - ln p,

whatever the gradient that was used: a wrong one costs acceptance, no more (Neal, MCMC using Hamiltonian
dynamics, 2011). n depends on no chain, and is drawn anew each time lest trajectories close.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from pymc_features.smc.proposals.proposal import moments

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
