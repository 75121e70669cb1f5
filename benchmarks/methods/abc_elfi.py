"""ELFI (optional): SMC ABC with the tolerances epsilon times 128, 64, ..., 2, 1, in batches.

Its adaptive variant cannot be told where to end. ELFI asks for matplotlib < 3.9 and this package for a later
one, so no resolver installs both; with `pip install --no-deps elfi GPy paramz` and what these import it runs.
"""

import numpy as np

from benchmarks.abc_problem import LOWER, UPPER
from benchmarks.methods.result import Accepted, equally_weighted

HALVINGS = 7
BATCH = 250


def method(problem, seed):
    """One run with the batched simulator."""
    import elfi

    simulations = 0

    def simulate(first, second, batch_size=1, random_state=None):
        nonlocal simulations
        simulations += np.size(first)
        return problem.rho(np.column_stack([np.ravel(first), np.ravel(second)]))

    model = elfi.ElfiModel()
    priors = [elfi.Prior("uniform", LOWER, UPPER - LOWER, model=model, name=f"theta_{k}") for k in (1, 2)]
    simulator = elfi.Simulator(simulate, *priors, observed=np.zeros(1), name="rho", model=model)
    distance = elfi.Discrepancy(lambda rho, observed: np.ravel(rho), simulator, name="distance", model=model)
    thresholds = problem.exact.epsilon * 2.0 ** np.arange(HALVINGS, -1, -1)
    found = elfi.SMC(distance, batch_size=BATCH, seed=seed).sample(problem.draws, thresholds, bar=False)
    points = equally_weighted(found.samples_array, found.weights, np.random.default_rng(seed))
    return Accepted(points, simulations)
