"""Mean squares of the misfit between response and data, Eq. (3), without ever storing the response."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import n_outputs
from pymc_features.simulators.oscillators.recursion import BLOCK, advance, check_sizes, modal_system


@jit
def march_misfit(
    parameters, acceleration, dt, substeps, stride, sensors, n_modes, quantity, observed, chained
):
    """Mean square misfits (s,); `chained` (3, s), unless None, gets what else `chain_misfit` returns."""
    mass, stiffness, rayleigh, ratios = parameters
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
        if chained is not None:
            chained[:] = np.nan
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
                if chained is not None:
                    block[j, b] = misfit
            errors[j] += squares
            if chained is not None:
                add_increments(block[j], count, first == 0, chained, j)
    for j in range(sensors.size):
        errors[j] /= total
        if chained is not None:
            chained[0, j] /= total
    return errors


@jit
def add_increments(misfits, count, is_first, chained, j):
    """Add the squared increments of `count` misfits of sensor j; keep its first misfit and its last one."""
    if is_first:
        chained[0, j], chained[1, j], chained[2, j] = 0.0, misfits[0], misfits[0]
    squares = (misfits[0] - chained[2, j]) ** 2
    for b in range(1, count):
        step = misfits[b] - misfits[b - 1]
        squares += step * step
    chained[0, j] += squares
    chained[2, j] = misfits[count - 1]


@jit
def chain_discrepancy(parameters, excitation, wanted, observed):
    """e_j = (1/N_D) sum_k [y_j(k) - g_j(k; theta)]^2 of a spring-mass chain, Eq. (3).

    Parameters as in `recursion.chain_response`, and `observed` (s, u), the data in the units of
    the quantity. Returns an array (s,), NaN where the parameters describe no structure. Memory: a
    few blocks of 128 samples, whatever the length of the record.
    """
    mass, stiffness, rayleigh, ratios = parameters
    acceleration, dt, substeps, stride = excitation
    sensors, n_modes, quantity = wanted
    return march_misfit(
        *((mass, stiffness, rayleigh, ratios), acceleration, dt, substeps, stride),
        *(sensors, n_modes, quantity, observed, None),
    )


@jit
def chain_misfit(parameters, excitation, wanted, observed):
    """What the log-density of errors correlated in time needs of the misfit r = y - g of each sensor.

    Parameters and cost in memory as those of `chain_discrepancy`. Returns an array (s, 4): e_j, the sum of
    the squared increments r(k) - r(k - 1) over N_D, the first misfit and the last.
    """
    mass, stiffness, rayleigh, ratios = parameters
    acceleration, dt, substeps, stride = excitation
    sensors, n_modes, quantity = wanted
    result, chained = np.empty((sensors.size, 4)), np.empty((3, sensors.size))
    result[:, 0] = march_misfit(
        *((mass, stiffness, rayleigh, ratios), acceleration, dt, substeps, stride),
        *(sensors, n_modes, quantity, observed, chained),
    )
    result[:, 1:] = chained.T
    return result
