"""What a method returns, and how it says that it cannot run."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Result:
    """One run of one method.

    Attributes
    ----------
    theta, sigma : array (draws,)
        Equally weighted draws.
    n_evaluations : float
        Evaluations of the likelihood, of the population in all; NaN where the method does not tell.
    log_evidence : float
        NaN where the method gives none.
    set_up : float
        Seconds before the first particle is evaluated, spent anew in every run.
    counting : float
        Seconds spent on counting evaluations rather than on sampling; not counted as the method's.
    """

    theta: np.ndarray
    sigma: np.ndarray
    n_evaluations: float
    log_evidence: float = np.nan
    set_up: float = 0.0
    counting: float = 0.0


@dataclass(frozen=True, eq=False)
class Accepted:
    """One run of one likelihood-free method.

    Attributes
    ----------
    points : array (draws, 2)
        Equally weighted draws of theta_1, theta_2.
    simulations : int
    log_probability : float
        Log of P(rho <= epsilon); NaN where the method gives none.
    counting : float
        As in `Result`.
    """

    points: np.ndarray
    simulations: int
    log_probability: float = np.nan
    counting: float = 0.0


class NotThereError(Exception):
    """The method is not part of the installed package."""


def equally_weighted(points, weights, rng):
    """Systematic resampling: as many rows as `points`, each kept in proportion to its weight."""
    count = len(points)
    positions = (rng.random() + np.arange(count)) / count
    cumulative = np.cumsum(weights)
    return points[np.searchsorted(cumulative / cumulative[-1], positions)]
