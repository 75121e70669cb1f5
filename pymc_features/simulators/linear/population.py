"""Discrepancies of populations of linear structures: modes one by one, the recursion for several at once.

The parameters are those of `Arguments`; theta, rayleigh and ratios have one more axis in front, a row for
each particle or one for all.
"""

import numpy as np

from pymc_features.simulators.compilation import jit
from pymc_features.simulators.lanes import LANES
from pymc_features.simulators.linear.arguments import (
    N_ARGUMENTS,
    N_PARAMETERS,
    Arguments,
    n_particles,
    one_of,
    writable,
)
from pymc_features.simulators.linear.classical import classical_matrices
from pymc_features.simulators.linear.response import evaluate
from pymc_features.simulators.linear.system import is_coupled, observe, solve_system
from pymc_features.simulators.recursion import N_ROWS
from pymc_features.simulators.recursion_lanes import (
    N_COEFFICIENTS,
    SAMPLES,
    fill_recursion,
    march,
    take_sums,
)


def linear_population_discrepancy(*arguments) -> np.ndarray:
    """e_j (p, s) of Eq. (3) of all particles, of the data that follow the arguments; NaN in invalid rows.

    Memory: the result and a few blocks, whatever the length of the record and the number of particles.
    """
    return march_population(arguments, False)[:, :, 0].copy()


def linear_population_misfit(*arguments) -> np.ndarray:
    """What `linear_misfit` returns, for all particles: (p, s, 4)."""
    return march_population(arguments, True)


def march_population(arguments, with_increments):
    """Misfits (p, s, 1 or 4) of all particles."""
    parameters, rest = arguments[:N_PARAMETERS], arguments[N_PARAMETERS:N_ARGUMENTS]
    (observed,) = arguments[N_ARGUMENTS:]
    count = n_particles(parameters)
    shared = Arguments(*one_of(parameters, 0), *rest)
    shared.check(observed)
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


@jit
def march_group(tables, own_shapes, own_direct, acceleration, substeps, stride, observed, increments):
    """Misfits of up to `LANES` particles whose modes are uncoupled, under one input.

    Parameters
    ----------
    tables, own_shapes, own_direct : array (particles, 11, m), (particles, s, m), (particles, s)
        As in `recursion.modal_system`; the last is overwritten.
    increments
        None if only the squares are wanted, not their increments.

    Returns
    -------
    array (particles, s, 1), or (particles, s, 4) with increments
    """
    count, n_sensors, n_modes = own_shapes.shape
    n_times = observed.shape[1]
    even_sensors, even_modes = n_sensors + n_sensors % 2, n_modes + n_modes % 2
    coefficients, states = np.zeros((N_COEFFICIENTS * even_modes, LANES)), np.zeros((2 * even_modes, LANES))
    shapes, direct = np.zeros((even_sensors * even_modes, LANES)), np.zeros((even_sensors, LANES))
    errors = np.empty((even_sensors, LANES))
    work = (
        np.empty((SAMPLES * even_modes, LANES)),
        np.empty(SAMPLES * stride),
        np.empty((n_sensors, SAMPLES)),
    )
    for lane in range(count):
        fill_recursion(
            *(tables[lane], own_shapes[lane], own_direct[lane], acceleration[0], lane),
            *(coefficients, states, shapes, direct),
        )
    settings = (coefficients, states, shapes, direct, acceleration, substeps, stride, observed, errors, work)
    if increments is None:
        march(*settings, None, None)
        result = np.empty((count, n_sensors, 1))
        take_sums(errors, None, None, n_times, result)
    else:
        chained = (
            *(np.empty((even_sensors, LANES)), np.empty((even_sensors, LANES))),
            np.empty((even_sensors, LANES)),
        )
        misfits = np.empty((even_sensors * SAMPLES, LANES))
        march(*settings, misfits, chained)
        result = np.empty((count, n_sensors, 4))
        take_sums(errors, misfits, chained, n_times, result)
    return result
