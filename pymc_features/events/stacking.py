"""Weights of models by how well their mixture predicts what it has not seen."""

import numpy as np

ITERATIONS, SMALL = 10_000, 1e-10


def stacking_weights(scores: np.ndarray) -> np.ndarray:
    """Weights (model,) with the largest sum over events of ln sum_k w_k p_k(event).

    `scores` (model, event) are ln p_k of each held-out event. The sum is concave in w; expectation and
    maximisation climb it, and each step w_k <- mean_e w_k p_ke / sum_j w_j p_je stays on the simplex.

    Yao, Vehtari, Simpson & Gelman, Bayesian Anal. 13, 917-1007 (2018), Eq. (4).
    """
    densities = np.exp(scores - scores.max(axis=0))
    weights = np.full(len(scores), 1.0 / len(scores))
    for _ in range(ITERATIONS):
        shares = weights[:, None] * densities
        new = (shares / shares.sum(axis=0)).mean(axis=1)
        if np.abs(new - weights).max() < SMALL:
            break
        weights = new
    return weights
