"""Rejection: draws from the prior are simulated in batches until enough lie within the tolerance.

A twentieth of the draws asked of the others, whose cost for each is the same: they are independent.
"""

import numpy as np

from benchmarks.abc_problem import LOWER, UPPER
from benchmarks.methods.result import Accepted

BATCH = 10_000
SHARE = 20


def method(problem, seed):
    """One run."""
    rng = np.random.default_rng(seed)
    accepted, simulations, wanted = [], 0, max(problem.draws // SHARE, 1)
    while sum(map(len, accepted)) < wanted:
        points = rng.uniform(LOWER, UPPER, (BATCH, 2))
        accepted.append(points[problem.rho(points) <= problem.exact.epsilon])
        simulations += BATCH
    found = np.concatenate(accepted)
    # too large by less than 1 / len(found): it stops at a success
    return Accepted(found, simulations, np.log(len(found) / simulations))
