"""Parts of a proposal where the draws so far were too few: around those whose weights are the largest.

Raftery & Bao, Estimating and projecting trends in HIV/AIDS generalized epidemics using incremental mixture
importance sampling, Biometrics 66 (2010).
"""

import numpy as np

from pymc_features.smc.proposals.fitted import HEAVIEST, FittedProposal
from pymc_features.smc.proposals.proposal import StudentT, moments

MOST_PATCHES = 4
HEAVIEST_OF_MOMENTS = 10.0  # weight of a draw in the moments of one, over the mean weight, at most
HEAVY = 4.0  # weight of a draw that is at the centre of one, over the mean weight
NEAR = (20, 4)  # draws that shape one: at least, and for each parameter
SHARES = (0.03, 0.1)  # of one patch among the proposal's draws


def patched(proposal: FittedProposal, points, x, weights) -> FittedProposal:
    """The proposal with Student-t distributions at the heaviest of some draws.

    Each has the moments of the draws next to it, weighed. There are none where no draw is heavy.

    Parameters
    ----------
    proposal : FittedProposal
    points : array (m, d)
        What it was fitted to; they say what is near.
    x : array (n, d)
    weights : array (n,)
        Their sum is one.
    """
    n, d = x.shape
    _, factor = moments(points, np.full(len(points), 1.0), np.full(len(points), 1.0))
    u = np.linalg.solve(factor, x.T).T
    n_near = min(n, NEAR[0] + NEAR[1] * d)
    moderate = np.minimum(weights, HEAVIEST_OF_MOMENTS / n) + 1.0 / n
    left, parts, shares = weights.copy(), [], []
    while len(parts) < MOST_PATCHES and left.max() * n > HEAVY:
        near = np.argpartition(((u - u[left.argmax()]) ** 2).sum(axis=1), n_near - 1)[:n_near]
        parts.append(StudentT(*moments(x[near], moderate[near], moderate[near]), HEAVIEST))
        shares.append(np.clip(2.0 * weights[near].sum(), *SHARES))
        left[near] = 0.0
    if not parts:
        return proposal
    *first, safeguard = proposal.components
    *of_first, of_safeguard = (1.0 - np.sum(shares)) * proposal.weights
    return FittedProposal([*first, *parts, safeguard], np.array([*of_first, *shares, of_safeguard]))
