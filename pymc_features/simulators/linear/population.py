"""Discrepancies of populations of linear structures: modes one by one, the recursion for several at once.

Dense structures with classical damping under one input stay in compiled code, `dense_population`.

The parameters are those of `Arguments`; theta, rayleigh and ratios have one more axis in front, a row for
each particle or one for all.
"""

import numpy as np

from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.linear.arguments import N_PARAMETERS, Arguments, n_particles, one_of, writable
from pymc_features.simulators.linear.dense_population import march_dense
from pymc_features.simulators.linear.response import evaluate
from pymc_features.simulators.linear.system import is_coupled, observe, solve_system
from pymc_features.simulators.oscillators.march import classical_matrices
from pymc_features.simulators.oscillators.population_march import march_group
from pymc_features.simulators.oscillators.recursion import N_ROWS


def linear_population_discrepancy(parameters, excitation, wanted, observed) -> np.ndarray:
    """e_j (p, s) of Eq. (3) of all particles, of the data that follow the arguments; NaN in invalid rows.

    Memory: the result and a few blocks, whatever the length of the record and the number of particles.
    """
    return march_population(parameters, (*excitation, *wanted), observed, False)[:, :, 0].copy()


def linear_population_misfit(parameters, excitation, wanted, observed) -> np.ndarray:
    """What `linear_misfit` returns, for all particles: (p, s, 4)."""
    return march_population(parameters, (*excitation, *wanted), observed, True)


def march_population(parameters, rest, observed, with_increments):
    """Misfits (p, s, 1 or 4) of all particles."""
    parameters, rest = parameters[:N_PARAMETERS], (*parameters[N_PARAMETERS:], *rest)
    count = n_particles(parameters)
    shared = Arguments(*one_of(parameters, 0), *rest)
    shared.check(observed)
    if shared.is_dense and shared.is_classical and shared.inputs.shape[0] == 1:
        return march_dense(
            tuple(writable(array) for array in parameters),
            *((writable(shared.mass), writable(shared.stiffness)), shared.loads, shared.inputs[0]),
            *(shared.step, shared.grid, shared.outputs, shared.n_modes, shared.quantity),
            *(writable(observed), with_increments or None),
        )
    n_sensors, m = shared.shape[0], shared.n_modes
    result = np.full((count, n_sensors, 4 if with_increments else 1), np.nan)
    tables = np.empty((LANES, N_ROWS, m)), np.empty((LANES, n_sensors, m)), np.empty((LANES, n_sensors))
    settings = (
        *(shared.inputs[0], *shared.grid),
        *(writable(observed), with_increments or None),
    )
    waiting = []
    for p in range(count):
        a = Arguments(*one_of(parameters, p), *rest)
        system = solve_system(a)
        if system is None:
            continue
        if is_coupled(system.drag) or a.acceleration.shape[0] > 1:
            result[p] = evaluate(a, system, observed)[:, : result.shape[2]]
            continue
        seen, direct = observe(a, system)
        table, shapes = classical_matrices(a, system, seen)
        for array, own in zip(tables, (table, shapes[0], direct[:, 0]), strict=True):
            array[len(waiting)] = own
        waiting.append(p)
        if len(waiting) == LANES:
            result[waiting] = march_group(*tables, *settings)
            waiting = []
    if waiting:
        result[waiting] = march_group(*(array[: len(waiting)] for array in tables), *settings)
    return result
