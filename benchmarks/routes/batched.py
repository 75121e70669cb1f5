"""Our kernel for a whole population; until it exists, the scalar one in a loop stands in for it."""

from benchmarks.routes import scalar

try:
    from pymc_features.simulators import population_discrepancy
except ImportError:
    population_discrepancy = None

IS_STAND_IN = population_discrepancy is None


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s)."""
    if IS_STAND_IN:
        return scalar.prepare(case)
    arguments = (
        case.mass[None],
        case.stiffness,
        case.rayleigh[None],
        0.0 * case.mass[None],
        case.acceleration,
        case.dt,
        case.substeps,
        1,
        case.sensors,
        case.n_dof,
        0,
        case.observed,
    )
    return lambda: population_discrepancy(*arguments)
