"""e_j of populations under long records: from a table, and by the march where that is not sure.

A structure's numbers do not depend on the others of its population, nor on what the table was asked before.
"""

import warnings

import numpy as np

from pymc_features.exceptions import PopulationWarning
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.mean_squares.evaluate import evaluate
from pymc_features.simulators.mean_squares.kept import KEPT
from pymc_features.simulators.mean_squares.poles import find_poles
from pymc_features.simulators.mean_squares.table import MOST_BYTES, empty_reach

FEWEST_SAMPLES = 2000  # below, the march is as fast
CHUNK = 1024  # particles at a time
ROUNDING = 5e-15  # errors of a sum, relative to what `evaluate` calls sizes: ten times what was found
SURE = 1e-8  # error of e_j that makes no difference to TN and EXP
NATS = 1e-3  # error of the log-likelihood of independent samples, whose variance is near e_j
AGREEMENT = 1e-6  # of e_j with the march


def is_long(stride, observed) -> bool:
    """Whether tables are faster: many samples, one for each step of the recursion."""
    return stride == 1 and observed.shape[-1] >= FEWEST_SAMPLES


def mean_squares(family, arguments, observed) -> np.ndarray:
    """e_j (p, s) of Eq. (3) for a population; NaN in the rows whose parameters describe no structure.

    Parameters
    ----------
    family : Family
        With the kernels "population_discrepancy", the march, and "population_systems".
    arguments : tuple
        Parameters, with a row for each particle or one for all, `Excitation` and `Outputs`.
    observed : array (s, N)
        Data.
    """
    parameters, given, wanted = arguments
    data = KEPT.of(observed, given)
    excitation = given._replace(acceleration=data.acceleration.reshape(given.acceleration.shape))
    march, shared = family.kernels["population_discrepancy"], (excitation, wanted, data.observed)
    rows = max(getattr(parameters, name).shape[0] for name in family.parameters)

    def only(which):
        """The arguments of some particles."""
        own = {name: getattr(parameters, name) for name in family.parameters}
        own = {name: np.ascontiguousarray(x[which]) for name, x in own.items() if x.shape[0] > 1}
        return parameters._replace(**own), *shared

    parts = []
    for first in range(0, rows, CHUNK):
        part = np.arange(first, min(first + CHUNK, rows))
        systems = None if data.table is None else family.kernels["population_systems"](*only(part))
        if systems is None:
            return march(parameters, *shared)
        e, is_sure = from_table(data, systems, wanted.quantity)
        if not is_sure.all():
            e[~is_sure] = march(*only(part[~is_sure]))
        parts.append(e)
    e = np.concatenate(parts)
    if data.until_check <= 0:
        data.until_check = observed.shape[1]
        if not data.same(observed, np.atleast_2d(given.acceleration)):  # changed in place
            KEPT.forget(data)
            return mean_squares(family, arguments, observed)
        some = np.unique(np.linspace(0, rows - 1, LANES).astype(int))
        if not agree(e[some], march(*only(some))):
            data.table = None
            return march(parameters, *shared)
    data.until_check -= rows
    return e


def from_table(data, systems, quantity):
    """e_j (p, s), and whether they are as exact as the likelihoods need, (p,)."""
    table, sums = data.table, data.table.of.sums
    n_sensors, n_times = data.observed.shape
    lowest, highest = empty_reach(table.mesh)
    poles = find_poles(systems, table.mesh, quantity, lowest, highest)
    n_particles = len(systems.valid)
    if n_particles > 1 and table.size_of(lowest, highest) > MOST_BYTES:
        half = n_particles // 2
        halves = (type(systems)(*(x[part] for x in systems)) for part in (slice(half), slice(half, None)))
        return tuple(
            np.concatenate(x) for x in zip(*(from_table(data, h, quantity) for h in halves), strict=True)
        )
    if table.cover(lowest, highest):
        data.until_check = 0
    e, sizes = np.full((n_particles, n_sensors), np.nan), np.full((n_particles, n_sensors), np.inf)
    evaluate(table.mesh, sums, systems, poles, e, sizes)
    bound = min(SURE, 2.0 * NATS / (n_times * n_sensors))
    is_sure = (ROUNDING * sizes <= bound * e).all(axis=1) | ~systems.valid
    return e / n_times, is_sure


def agree(e, marched) -> bool:
    """Whether a table and the march give the same; a vector of particles in N costs a twentieth."""
    if np.allclose(e, marched, rtol=AGREEMENT, atol=0.0, equal_nan=True):
        return True
    warnings.warn(
        "mean squares from a table differ from those of the march through the record, which is taken from "
        "now on. Please report the model.",
        PopulationWarning,
        stacklevel=2,
    )
    return False
