"""Our kernel for a whole population; until it exists, the scalar one in a loop stands in for it."""

from benchmarks.routes import scalar

try:
    from pymc_features.simulators import population_discrepancy, population_misfit
except ImportError:
    population_discrepancy = None

IS_STAND_IN = population_discrepancy is None


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s)."""
    if IS_STAND_IN:
        return scalar.prepare(case)
    inputs = arguments(case)
    return lambda: population_discrepancy(*inputs)


def prepare_with_increments(case):
    """The same by the kernel that also sums the increments of the misfit, for errors correlated in time."""
    if IS_STAND_IN:
        return scalar.prepare(case)
    inputs = arguments(case)
    return lambda: population_misfit(*inputs)[..., 0]


def arguments(case):
    """What the kernels take."""
    return (
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
