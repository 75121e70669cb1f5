"""Uncoupled modes under several inputs, taken through time: the response, or its misfit from data.

Each mode is the oscillator of `recursion`; the responses to the inputs add up.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import interpolate
from pymc_features.simulators.oscillators.misfit import take_block
from pymc_features.simulators.oscillators.recursion import BLOCK, N_ROWS, advance, write_table


@jit
def input_shapes(system):
    """S Phi Gamma (d, s, m): what the output of each mode adds to the response, for each input."""
    (n_sensors, n_modes), n_inputs = system.shapes.shape, system.participation.shape[1]
    products = np.empty((n_inputs, n_sensors, n_modes))
    for i in range(n_inputs):
        for j in range(n_sensors):
            for r in range(n_modes):
                products[i, j, r] = system.shapes[j, r] * system.participation[r, i]
    return products


@jit
def march_modes(system, feed, excitation, quantity, observed, history, sums):
    """Store the response of a structure, or compare it with data.

    Parameters
    ----------
    system : ModalSystem
    feed : array (s, d)
        What stands before the inputs in the response, see `feed_through`.
    excitation : Excitation
        Of d inputs (d, t).
    quantity : int
        Position in `QUANTITIES`.
    observed : array (s, u)
        Data; not read if there is a `history`.
    history : array (s, u) or (0, 0)
        Written, unless it is empty.
    sums : array (q, s)
        Otherwise: sums over the misfit, see `misfit.compare_block`; updated.
    """
    inputs, dt, substeps, stride = excitation
    n_sensors, n_modes = system.shapes.shape
    n_inputs, total = inputs.shape[0], max(history.shape[1], observed.shape[1])
    table = np.empty((N_ROWS, n_modes))
    write_table(system.omega, system.damping, dt / substeps, quantity, table)
    ground, outputs = np.empty((n_inputs, BLOCK * stride + 1)), np.empty((BLOCK, n_modes))
    q, p = np.zeros((n_inputs, n_modes)), np.zeros((n_inputs, n_modes))
    block, part = np.empty((n_sensors, BLOCK)), np.empty((n_sensors, BLOCK))
    products = input_shapes(system)
    for first in range(0, total, BLOCK):
        count = min(BLOCK, total - first)
        for i in range(n_inputs):
            interpolate(inputs[i], substeps, first * stride, ground[i])
            advance(table, q[i], p[i], ground[i], stride, count, outputs)
            target = block if i == 0 else part
            np.dot(products[i], outputs.T, target)
            for j in range(n_sensors):
                for b in range(count):
                    target[j, b] += feed[j, i] * ground[i, b * stride]
            if i > 0:
                block += part
        take_block(block, first, count, observed, history, sums)
