"""Our way for a whole population under a long record: from a table that is kept with the data."""

from benchmarks.routes import batched
from pymc_features.simulators import FAMILIES
from pymc_features.simulators.mean_squares.population import mean_squares


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s)."""
    *arguments, observed = batched.arguments(case)
    return lambda: mean_squares(FAMILIES["chain"], tuple(arguments), observed)
