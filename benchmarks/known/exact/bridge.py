"""The evidence from draws of the posterior and of a proposal together: bridge sampling.

r = E_q[l / (s_1 l + s_2 r)] / E_p[1 / (s_1 l + s_2 r)] with l = p / q, p not normalised and r its evidence
(Meng & Wong, Statistica Sinica 6, 1996). No weight can be large: where the proposal has
too little, the draws have much.
"""

import numpy as np

GROUPS = 16  # of chains and of points, for the standard error
ITERATIONS = 200


def fixed_point(of_draws, of_points, share):
    """ln r from ln l at draws of p (n,) and at points of q (m,); `share`: s_1."""
    log_r = np.median(of_draws)
    for _ in range(ITERATIONS):
        floor = np.log1p(-share) + log_r
        above = of_points - np.logaddexp(np.log(share) + of_points, floor)
        below = -np.logaddexp(np.log(share) + of_draws, floor)
        new = log_mean(above) - log_mean(below)
        if abs(new - log_r) < 1e-9:
            return new
        log_r = new
    return log_r


def log_mean(x):
    """ln mean exp."""
    return x.max() + np.log(np.exp(x - x.max()).mean())


def log_evidence(of_draws, of_points, effective):
    """Estimate and standard error from ln p / q at draws (chain, draw) and at points (m,).

    `effective`: number of independent draws that the chains are worth.
    """
    share = effective / (effective + len(of_points))
    groups = [
        fixed_point(draws.ravel(), points, share)
        for draws, points in zip(
            np.array_split(of_draws, GROUPS), np.array_split(of_points, GROUPS), strict=True
        )
    ]
    error = np.std(groups, ddof=1) / np.sqrt(GROUPS)
    return float(fixed_point(of_draws.ravel(), of_points, share)), float(error)
