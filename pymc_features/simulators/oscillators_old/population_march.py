"""The recursion of several particles with uncoupled modes, and its comparison with the data."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.oscillators_old.population_recursion import (
    N_COEFFICIENTS,
    SAMPLES,
    fill_recursion,
    march,
    take_sums,
)


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
