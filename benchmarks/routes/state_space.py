"""SciPy's general routine: `scipy.signal.lsim`, first-order hold of the whole state space.

`scipy.signal.dlsim` with `cont2discrete(..., method="foh")` costs the same Python loop over time.
"""

import numpy as np
from scipy.signal import lsim

from benchmarks.case import ALPHA, BETA
from benchmarks.routes.filters import chain_matrix


def response(stiffness, ground, step):
    """Absolute acceleration of every degree of freedom, shape (n, N_D), from rest at sample 0."""
    n = stiffness.size
    matrix = chain_matrix(stiffness)
    damping = ALPHA * np.eye(n) + BETA * matrix
    output = -np.hstack([matrix, damping])
    system = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), output])
    excitation = np.concatenate([np.zeros(n), -np.ones(n)])[:, None]
    _, histories, _ = lsim(
        (system, excitation, output, np.zeros((n, 1))), ground, step * np.arange(ground.size)
    )
    return histories.T


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s)."""
    ground = case.fine_acceleration

    def evaluate():
        histories = (response(k, ground, case.step)[case.sensors] for k in case.stiffness)
        return np.array([np.mean((history - case.observed) ** 2, axis=1) for history in histories])

    return evaluate
