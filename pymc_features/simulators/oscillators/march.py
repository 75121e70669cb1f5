"""Exact response of uncoupled modes to several inputs that are linear between their samples.

Each mode is the oscillator of `recursion`; the responses to the inputs add up.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    n_outputs,
)
from pymc_features.simulators.oscillators.blocks import take_block
from pymc_features.simulators.oscillators.recursion import (
    BLOCK,
    N_ROWS,
    advance,
    first_order_hold,
    output_row,
)

STIFFEST = 1e6  # omega h and D h of a mode that can be stepped
SMALLEST_FREQUENCY = 1e-100  # rad/s, stands for zero: its square drowns, and D = 2 zeta omega is kept


@jit
def classical_drag(omega, rayleigh, ratios, step, drag):
    """Write D = alpha + beta omega^2 + 2 ratio omega (m,) [1/s]; False if negative or too stiff."""
    for r in range(omega.size):
        drag[r] = rayleigh[0] + rayleigh[1] * omega[r] ** 2 + 2.0 * ratios[r] * omega[r]
        if not (drag[r] >= 0.0 and max(omega[r], drag[r]) * step < STIFFEST):  # NaN too
            return False
    return True


@jit
def feed_through(seen, participation, pushed, moved, quantity, complete, direct):
    """Write what stands before the inputs in the response, (s, d).

    Parameters
    ----------
    seen : array (s, m)
        Mode shapes at the outputs.
    participation, pushed : array (m, d)
        Phi' load, and Phi' forces alone.
    moved : array (s, d)
        What the outputs see of the supports' motion.
    complete : bool
        Whether all modes are kept: their sum is then known without its rounding error. With modes left out
        the absolute acceleration keeps the ground's share of them.
    """
    direct[:] = 0.0
    if quantity not in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION):
        return
    for j in range(direct.shape[0]):
        for i in range(direct.shape[1]):
            carried, forced = 0.0, 0.0
            for r in range(seen.shape[1]):
                carried += seen[j, r] * participation[r, i]
                forced += seen[j, r] * pushed[r, i]
            whole = moved[j, i] if quantity == ABSOLUTE_ACCELERATION else 0.0
            direct[j, i] = whole - moved[j, i] + forced if complete else whole - carried


@jit
def modal_table(omega, drag, step, quantity, table):
    """Write the recursion table (11, m) of oscillators q" + D q' + omega^2 q = -a.

    Parameters
    ----------
    omega, drag : array (m,)
        [rad/s] and D [1/s], not negative.
    """
    for r in range(omega.size):
        frequency = max(omega[r], SMALLEST_FREQUENCY)
        w, zeta = frequency * step, drag[r] / (2.0 * frequency)
        first_order_hold(w, zeta, table, r)
        output_row(quantity, w, zeta, step, table, r)


@jit
def march_modes(table, shapes, direct, inputs, substeps, stride, observed, history, sums):
    """Carry uncoupled modes through the record; see `take_block` for what becomes of the response.

    Parameters
    ----------
    table : array (11, m)
        From `modal_table`.
    shapes : array (d, s, m)
        Output of each mode per unit participation, times its participation in each input.
    direct : array (s, d)
        Feed-through of the inputs.
    inputs : array (d, t)
    substeps, stride : int
        As in `advance`.
    """
    n_inputs, n_sensors, n_modes = shapes.shape
    total = n_outputs(inputs.shape[1], substeps, stride)
    modal, ground = np.empty((BLOCK, n_modes)), np.empty(BLOCK)
    part, block = np.empty((n_sensors, BLOCK)), np.empty((n_sensors, BLOCK))
    q, p = np.zeros((n_inputs, n_modes)), np.zeros((n_inputs, n_modes))
    for first in range(0, total, BLOCK):
        count = min(BLOCK, total - first)
        block[:] = 0.0
        for i in range(n_inputs):
            advance(table, q[i], p[i], inputs[i], substeps, stride, first, count, modal, ground)
            np.dot(shapes[i], modal.T, part)
            for j in range(n_sensors):
                for b in range(count):
                    block[j, b] += part[j, b] + direct[j, i] * ground[b]
        take_block(block, first, count, observed, history, sums)


def classical_matrices(a, system, seen):
    """Table and shapes of `march_modes`."""
    drag = system.drag if system.drag.ndim == 1 else np.maximum(np.diagonal(system.drag), 0.0)
    table = np.empty((N_ROWS, system.omega.size))
    modal_table(system.omega, np.ascontiguousarray(drag), a.step, a.quantity, table)
    return table, np.ascontiguousarray(system.participation.T[:, None, :] * seen)
