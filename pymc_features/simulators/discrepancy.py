"""Mean-square discrepancy between response and data, Eq. (3), without ever storing the response."""

import numpy as np

from pymc_features.simulators.compilation import jit
from pymc_features.simulators.recursion import (
    BLOCK,
    advance,
    check_sizes,
    modal_system,
    n_outputs,
)


@jit
def chain_discrepancy(
    mass,
    stiffness,
    rayleigh,
    ratios,
    acceleration,
    dt,
    substeps,
    stride,
    sensors,
    n_modes,
    quantity,
    observed,
):
    """e_j = (1/N_D) sum_k [y_j(k) - g_j(k; theta)]^2 of a spring-mass chain, Eq. (3).

    Parameters as in `recursion.chain_response`, and `observed` (s, u), the data in the units of
    the quantity. Returns an array (s,), NaN where the parameters describe no structure. Memory: a
    few blocks of 128 samples, whatever the length of the record.
    """
    check_sizes(mass, stiffness, rayleigh, ratios, sensors, n_modes)
    total = n_outputs(acceleration.size, substeps, stride)
    if observed.shape[0] != sensors.size or observed.shape[1] != total:
        raise ValueError("`observed` must have the shape (sensor, time) of the response")
    errors = np.zeros(sensors.size)
    valid, table, shapes, direct = modal_system(
        mass, stiffness, rayleigh, ratios, dt / substeps, sensors, n_modes, quantity
    )
    if not valid:
        errors[:] = np.nan
        return errors
    q = np.zeros(n_modes)
    p = np.zeros(n_modes)
    modal = np.empty((BLOCK, n_modes))
    ground = np.empty(BLOCK)
    block = np.empty((sensors.size, BLOCK))
    for first in range(0, total, BLOCK):
        count = min(BLOCK, total - first)
        advance(table, q, p, acceleration, substeps, stride, first, count, modal, ground)
        np.dot(shapes, modal.T, block)
        for j in range(sensors.size):
            data = observed[j, first : first + count]
            squares = 0.0
            for b in range(count):
                misfit = data[b] - block[j, b] - direct[j] * ground[b]
                squares += misfit * misfit
            errors[j] += squares
    for j in range(sensors.size):
        errors[j] /= total
    return errors
