"""parallel-abus (optional): Bayesian updating with subset simulation (aBUS-SuS), 1000 samples a level.

Its list of independent distributions uses the first one for every parameter, so it is given the unit cube.
"""

import numpy as np

from benchmarks.methods.result import Result
from benchmarks.problem import DRAWS, CountedLikelihood, from_unit_cube

LEVEL = 0.1  # conditional probability of a level, as in its examples


def method(problem, seed):
    """One run with the scalar likelihood; the package changes NumPy's global state, put back here."""
    errors, printing = np.geterr(), np.get_printoptions()
    try:
        from parallel_abus import ERADist, aBUS_SuS

        np.random.seed(seed)
        likelihood = CountedLikelihood(problem)
        priors = [ERADist("uniform", "PAR", [0.0, 1.0]) for _ in range(2)]
        _, _, samples, log_evidence, *_ = aBUS_SuS(DRAWS, LEVEL, likelihood.of_unit_cube, priors)
    finally:
        np.seterr(**errors)
        np.set_printoptions(**printing)
    draws = from_unit_cube(samples[-1][:, :2])
    return Result(draws[:, 0], draws[:, 1], likelihood.calls, float(log_evidence))
