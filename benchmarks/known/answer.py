"""A problem by its name: the model, what a sampler should find, and how to read its draws."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

PROBABILITIES = np.array([0.05, 0.5, 0.95])


@dataclass(frozen=True, eq=False)
class Answer:
    """What is known of a posterior.

    Attributes
    ----------
    labels : list of str
        Scalar parameters, d of them, in the order of the model's free variables.
    quantiles : array (3, d)
        5, 50 and 95 % quantiles.
    log_evidence : float
    quantile_se : array (3, d)
        Monte-Carlo standard errors of the quantiles; zeros where they are exact.
    log_evidence_se : float
        Zero where it is exact.
    note : str
        What to know before trusting it; empty if there is nothing.
    """

    labels: list[str]
    quantiles: np.ndarray
    log_evidence: float
    quantile_se: np.ndarray
    log_evidence_se: float = 0.0
    note: str = ""

    @classmethod
    def exact(cls, labels, quantiles, log_evidence):
        """An answer without error."""
        quantiles = np.asarray(quantiles, dtype=float)
        return cls(list(labels), quantiles, float(log_evidence), np.zeros_like(quantiles))

    @property
    def width(self) -> np.ndarray:
        """Between the 5 and 95 % quantiles, (d,)."""
        return self.quantiles[2] - self.quantiles[0]


@dataclass(frozen=True, eq=False)
class Modes:
    """Separated modes: their weights (k,) and `which(x)`, the mode of each draw (n, d), from 0 to k - 1."""

    weights: np.ndarray
    which: Callable

    def found(self, x) -> np.ndarray:
        """Share of the draws (n, d) in each mode, (k,)."""
        return np.bincount(self.which(x), minlength=len(self.weights)) / len(x)


@dataclass(frozen=True, eq=False)
class Problem:
    """A model and its answer.

    Attributes
    ----------
    model : pymc.Model
    answer : Answer
    modes : Modes or None
        Where the posterior has separated modes of known weights.
    draws : callable or None
        `draws(n, rng)`: exact independent draws (n, d), where they can be had.
    """

    model: object
    answer: Answer
    modes: Modes | None = None
    draws: Callable | None = None


def flat_draws(model, idata) -> np.ndarray:
    """Draws of all chains (n, d) from a DataTree, in the order of the answer's labels."""
    posterior = idata["posterior"]
    columns = [np.asarray(posterior[rv.name].values, dtype=float) for rv in model.free_RVs]
    return np.hstack([c.reshape(c.shape[0] * c.shape[1], -1) for c in columns])
