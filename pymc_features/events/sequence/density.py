"""A density fitted to the draws of a posterior, that it can be the prior of the next event."""

from functools import partial

import numpy as np

from pymc_features.smc.proposals.fitted import Unbent, fit_unbent
from pymc_features.smc.proposals.proposal import StudentMixture, StudentT, distinct, fit_mixture, moments

HELD_OUT = 0.25  # share of the draws that decide between the kinds of fits
SMALLEST = -300.0  # log-density that a held-out draw has at least in that decision
CLEARLY = 0.01  # nats for each draw by which more must be better than a Gaussian: what it adds is noise else
GAUSSIAN = 1e6  # degrees of freedom


class FittedDensity:
    """Student-t mixture, behind an unbending map where that is clearly better; normalised, drawn from
    exactly.

    Parameters
    ----------
    points : array (n, d)
        Draws, on the scale they are sampled on; some may be there many times.
    rng : Generator
    forgetting : float
        Covariances are divided by it.
    """

    def __init__(self, points: np.ndarray, rng: np.random.Generator, forgetting: float = 1.0):
        fitted = best_fit(*distinct(points), rng)
        self.map, mixture = (fitted.map, fitted.mixture) if isinstance(fitted, Unbent) else (None, fitted)
        wider = [StudentT(c.location, c.factor / np.sqrt(forgetting), c.degrees) for c in mixture.components]
        self.mixture = StudentMixture(wider, mixture.weights)

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """ln q (n,) at points (n, d)."""
        if self.map is None:
            return self.mixture.log_density(x)
        return Unbent(self.map, self.mixture).log_density(x)

    def draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Independent draws (n, d)."""
        z = self.mixture.draw(n, rng)
        return z if self.map is None else self.map.inverse(z)


def best_fit(x, weights, rng):
    """Choose from a Gaussian, a mixture and two behind maps by the density at points they have not seen.

    All but the first must be better by more than what a fit to some thousand draws gains by chance.
    """
    weights = np.asarray(weights, dtype=float)
    order = rng.permutation(len(x))
    held, rest = np.split(order, [int(HELD_OUT * len(x))])

    def score(kind):
        try:
            density = kind(x[rest], weights[rest], rng).log_density(x[held])
        except (np.linalg.LinAlgError, ValueError):
            return -np.inf
        return weights[held] @ np.maximum(density, SMALLEST) / weights[held].sum()

    kinds = [fit_gaussian, fit_mixture, fit_unbent, partial(fit_unbent, rotated=False)]
    scores = np.array([score(kind) for kind in kinds]) - CLEARLY * np.array([0.0, 1.0, 1.0, 1.0])
    return kinds[int(scores.argmax())](x, weights, rng)


def fit_gaussian(x, weights, rng) -> StudentMixture:
    """Mean and covariance, as a mixture of one."""
    shares = weights / weights.sum()
    return StudentMixture([StudentT(*moments(x, shares, shares), GAUSSIAN)], np.ones(1))
