"""Misfit r = y - g between data and response, and the derivatives of its statistics by the response.

The statistics of each sensor are

    e = (1/N) sum_k r_k^2  (Eq. 3),   c = (1/N) sum_k (r_k - r_{k-1})^2,   r_0,   r_{N-1},

of which all likelihoods but those of errors correlated in time need the first only. Where the data are NaN
there is a gap, whose samples add nothing to e; N stays the number of all samples. The other statistics are
NaN then.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit


@jit
def weigh_history(response, observed, weights):
    """Overwrite a whole response (s, u) by the derivatives of L by it; weights (s, 1) or (s, 4)."""
    n_sensors, total = response.shape
    for j in range(n_sensors):
        square_weight = 2.0 * weights[j, 0] / total
        if weights.shape[1] == 1:
            for k in range(total):
                misfit = observed[j, k] - response[j, k]
                response[j, k] = -square_weight * misfit if observed[j, k] == observed[j, k] else 0.0
            continue
        increment_weight = 2.0 * weights[j, 1] / total
        misfit, increment = observed[j, 0] - response[j, 0], 0.0
        for k in range(total):
            following = observed[j, k + 1] - response[j, k + 1] if k + 1 < total else misfit
            response[j, k] = -square_weight * misfit - increment_weight * (increment - (following - misfit))
            misfit, increment = following, following - misfit
        response[j, 0] -= weights[j, 2]
        response[j, total - 1] -= weights[j, 3]


def measured_difference(response, observed) -> np.ndarray:
    """Response less data, of any shape; zero where nothing was measured."""
    return np.where(np.isnan(observed), 0.0, response - observed)


def statistics(response, observed) -> np.ndarray:
    """Statistics (s, 4) of the misfit of a response (s, u) with data."""
    misfit, total = observed - response, response.shape[1]
    squares = np.square(measured_difference(response, observed)).sum(axis=1)
    increments = np.square(np.diff(misfit, axis=1)).sum(axis=1)
    return np.stack([squares / total, increments / total, misfit[:, 0], misfit[:, -1]], axis=1)
