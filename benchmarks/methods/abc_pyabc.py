"""pyABC (optional): ABC-SMC with its defaults, one process, history in memory.

The tolerance follows the median of each population, as it does by default, but ends at epsilon itself, where
pyABC would go on to whatever smaller one the median says.
"""

import numpy as np

from benchmarks.abc_problem import LOWER, UPPER
from benchmarks.methods.pymc_smc import Counted
from benchmarks.methods.result import Accepted, equally_weighted

NAMES = ("theta_1", "theta_2")


def method(problem, seed):
    """One run with the scalar simulator."""
    import pyabc

    epsilon, rho = problem.exact.epsilon, Counted(problem.rho_of_one)

    class MedianDownTo(pyabc.MedianEpsilon):
        def __call__(self, t):
            return max(super().__call__(t), epsilon)

    np.random.seed(seed)
    inference = pyabc.ABCSMC(
        lambda theta: {"rho": rho(np.array([theta[name] for name in NAMES]))},
        pyabc.Distribution(**{name: pyabc.RV("uniform", LOWER, UPPER - LOWER) for name in NAMES}),
        distance_function=lambda found, _: found["rho"],
        population_size=problem.draws,
        eps=MedianDownTo(),
        sampler=pyabc.SingleCoreSampler(),
    )
    inference.new("sqlite://", {"rho": 0.0})
    points, weights = inference.run(minimum_epsilon=epsilon).get_distribution()
    points = equally_weighted(points[list(NAMES)].to_numpy(), weights, np.random.default_rng(seed))
    return Accepted(points, rho.calls)
