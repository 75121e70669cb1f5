"""Stock PyMC: `pm.Simulator` and `pm.sample_smc` with its default kernel, one particle at a time.

The function returns rho, which PyMC's distances compare with zero, so that epsilon is their scale:
exp(-(rho / epsilon)^2 / 2) for "gaussian" and exp(-rho / epsilon) for "laplace". Or it returns the response,
as one would write it; then rho is |y - g|^2 / N_D, and "gaussian" with the scale sqrt(N_D epsilon) gives
exp(-rho / (2 epsilon)). All are soft: draws lie beyond the tolerance too.
"""

import numpy as np
import pymc as pm
from pymc.smc.kernels import IMH

from benchmarks.abc_problem import LOWER, UPPER
from benchmarks.methods.pymc_smc import Counted, run_chain
from benchmarks.methods.result import Accepted


def sample(problem, seed, function, observed, distance, epsilon):
    """Run one chain on a simulator `function(theta)`."""
    counted = Counted(function)
    with pm.Model() as model:
        pm.Simulator(
            "y",
            lambda rng, theta, size: counted(theta),
            pm.Uniform("theta", LOWER, UPPER, shape=2),
            distance=distance,
            sum_stat="identity",
            epsilon=epsilon,
            signature=f"(k)->({','.join(map(str, observed.shape))})",
            observed=observed,
        )
    idata = run_chain(IMH, model, problem.draws, seed)
    return Accepted(idata["posterior"]["theta"].values[0], counted.calls)


def of_rho(distance):
    """Method: one of PyMC's soft kernels on rho."""

    def method(problem, seed):
        def rho(theta):
            return problem.rho_of_one(theta)[None]

        return sample(problem, seed, rho, np.zeros(1), distance, problem.exact.epsilon)

    return method


def of_histories(problem, seed):
    """PyMC's default distance on the histories (10, 1000)."""
    scale = np.sqrt(problem.measured.shape[1] * problem.exact.epsilon)
    return sample(problem, seed, problem.response_of_one, problem.measured, "gaussian", scale)
