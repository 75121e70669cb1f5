"""Weights of stored draws, and how far they can be trusted."""

import numpy as np

from pymc_features.smc.proposals.mixture import pareto_k
from pymc_features.smc.proposals.pool import LARGEST_K

__all__ = ["LARGEST_K", "drawn_by", "normalised", "pareto_k"]


def normalised(log_weights: np.ndarray) -> np.ndarray:
    """Weights (..., draw) whose sum along the last axis is one."""
    weights = np.exp(log_weights - log_weights.max(axis=-1, keepdims=True))
    return weights / weights.sum(axis=-1, keepdims=True)


def drawn_by(weights: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One position (...,) for each row of normalised weights (..., draw)."""
    u = rng.random(weights.shape[:-1])[..., None]
    return (np.cumsum(weights, axis=-1) < u).sum(axis=-1).clip(max=weights.shape[-1] - 1)
