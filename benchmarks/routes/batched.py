"""Our kernel for a whole population."""

from pymc_features.simulators import ChainParameters, population_discrepancy, population_misfit


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s)."""
    inputs = arguments(case)
    return lambda: population_discrepancy(*inputs)


def prepare_with_increments(case):
    """The same by the kernel that also sums the increments of the misfit, for errors correlated in time."""
    inputs = arguments(case)
    return lambda: population_misfit(*inputs)[..., 0]


def arguments(case):
    """What the kernels take."""
    mass = case.mass[None]
    population = ChainParameters(mass, case.stiffness, case.rayleigh[None], 0.0 * mass)
    return population, *case.settings, case.observed
