"""ABC by subset simulation as its source has it: N points a level, p0 = 0.2, modified Metropolis.

Chiachio, Beck, Chiachio & Rus, SIAM J. Sci. Comput. 36 (2014), A1339-A1358. Each level keeps the 20 % with
the smallest rho and continues each by a chain of five states, the one kept included. A step proposes every
component by itself, normal around its present value with the standard deviation of the points kept, and
takes those that the prior accepts; what comes out is simulated and accepted within the level's tolerance.
The last tolerance is epsilon itself.
"""

import numpy as np

from benchmarks.abc_problem import LOWER, UPPER
from benchmarks.methods.result import Accepted

P0 = 0.2


def method(problem, seed):
    """One run with the batched simulator: all chains of a level in step."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(LOWER, UPPER, (problem.draws, 2))
    rho = problem.rho(points)
    simulations, log_probability, tolerance = len(points), 0.0, np.inf
    while tolerance > problem.exact.epsilon:
        tolerance = max(np.quantile(rho, P0), problem.exact.epsilon)
        kept = rho <= tolerance
        log_probability += np.log(kept.mean())
        points, rho, spent = level(problem, points[kept], rho[kept], tolerance, rng)
        simulations += spent
    return Accepted(points, simulations, log_probability)


def level(problem, points, rho, tolerance, rng):
    """Chains from the points kept, until there are as many states as draws are asked for."""
    states, spread, spent = [(points, rho)], points.std(axis=0), 0
    order = rng.permutation(len(points))  # of the chains that are one state longer
    while (missing := problem.draws - sum(len(x) for x, _ in states)) > 0:
        moving = order[:missing]
        points, rho = points.copy(), rho.copy()
        proposal = points[moving] + spread * rng.standard_normal((len(moving), 2))
        proposal = np.where((proposal > LOWER) & (proposal < UPPER), proposal, points[moving])
        new_rho = problem.rho(proposal)
        accepted = new_rho <= tolerance
        points[moving[accepted]], rho[moving[accepted]] = proposal[accepted], new_rho[accepted]
        states.append((points[moving], rho[moving]))
        spent += len(moving)
    return *(np.concatenate(column) for column in zip(*states, strict=True)), spent
