"""Our way for a whole population under a long record: from a table that is kept with the data."""

import numpy as np

from benchmarks.routes import batched
from pymc_features.simulators import FAMILIES
from pymc_features.simulators.long_records.misfits import Asked, Tables, from_table


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s)."""
    tables, asked = Tables(), asked_of(case)
    return lambda: from_table(tables, asked)[0]


def prepare_gradient(case):
    """Return a call for the gradient of the sum of e_j by all springs."""
    tables, asked = Tables(), asked_of(case, np.ones((len(case.stiffness), len(case.observed), 1)))
    return lambda: from_table(tables, asked)[1]


def prepare_marching_gradient(case):
    """Return a call for the same gradient by the march."""
    asked = asked_of(case, np.ones((len(case.stiffness), len(case.observed), 1)))
    return lambda: asked.march()[1]


def asked_of(case, weights=None):
    """What is asked of the chains of a case."""
    *arguments, observed = batched.arguments(case)
    return Asked(FAMILIES["chain"], tuple(arguments), observed, weights)
