"""Our way for a whole population under a long record: from a table that is kept with the data."""

import numpy as np

from benchmarks.routes import batched
from pymc_features.simulators import FAMILIES
from pymc_features.simulators.mean_squares.gradient.population import misfit_gradient
from pymc_features.simulators.mean_squares.population import mean_squares


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s)."""
    *arguments, observed = batched.arguments(case)
    return lambda: mean_squares(FAMILIES["chain"], tuple(arguments), observed)


def prepare_gradient(case):
    """Return a call for the gradient of the sum of e_j by all springs."""
    *arguments, observed = batched.arguments(case)
    weights = np.ones((len(case.stiffness), len(observed), 1))
    return lambda: misfit_gradient(FAMILIES["chain"], tuple(arguments), observed, weights)[1]


def prepare_marching_gradient(case):
    """Return a call for the same gradient by the march."""
    *arguments, observed = batched.arguments(case)
    weights, kernel = np.ones((len(case.stiffness), len(observed), 1)), "population_gradient"
    return lambda: FAMILIES["chain"].kernels[kernel](*arguments, observed, weights)[1]
