"""Modes that are in vector lanes already, put into `Lanes` for their march, all lanes at once."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import highest, load, splat, store, where_less
from pymc_features.simulators.compiled.vector_math import larger
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY
from pymc_features.simulators.oscillators.fast_modes import is_fast
from pymc_features.simulators.oscillators.hold import LARGEST, doubled, hold_coefficients, series
from pymc_features.simulators.oscillators.lanes import N_COEFFICIENTS
from pymc_features.simulators.oscillators.population import turned
from pymc_features.simulators.oscillators.recursion import can_be_damped, modal_damping
from pymc_features.simulators.oscillators.table import SMALLEST


@jit
def hold_lanes(s, d):
    """`hold.first_order_hold` of s and d in each lane, each halved and doubled as often as it needs."""
    bound, halvings = splat(LARGEST), splat(0.0)
    size = larger(s, d * d)
    while highest(size) > LARGEST:
        half = where_less(bound, size, splat(0.5), splat(1.0))
        halvings = halvings + where_less(bound, size, splat(1.0), splat(0.0))
        s, d, size = s * half * half, d * half, size * half * half
    f = series(s, d)
    done = splat(0.0)
    for _ in range(int(highest(halvings))):
        g = doubled(s, d, f)
        f = (
            where_less(done, halvings, g[0], f[0]),
            where_less(done, halvings, g[1], f[1]),
            where_less(done, halvings, g[2], f[2]),
            where_less(done, halvings, g[3], f[3]),
            where_less(done, halvings, g[4], f[4]),
            where_less(done, halvings, g[5], f[5]),
        )
        twice = where_less(done, halvings, splat(2.0), splat(1.0))
        s, d, done = s * twice * twice, d * twice, done + 1.0
    return hold_coefficients(s, d, f)


@jit
def positions(values, lane, order):
    """Write the positions (n,) of the numbers of a lane in ascending order."""
    for i in range(order.size):
        value, k = values[i, lane], i
        while k > 0 and values[order[k - 1], lane] > value:
            order[k] = order[k - 1]
            k -= 1
        order[k] = i


@jit
def take_lane(modes, lane, values, law, steps, order):
    """Write frequencies and damping of the lowest modes of one lane.

    Parameters
    ----------
    modes : tuple of arrays (m, LANES)
        omega [rad/s] and D [1/s], written; zero where the result is False.
    values : array (n, LANES)
        omega^2, in any order.
    law : DampingLaw
    steps : tuple of float
        Step of the recursion [s], and omega h of modes that can be stepped, see `fast_modes.highest_step`.
    order : integer array (n,)
        Written: the positions of the modes.

    Returns
    -------
    bool
        False where a damping is negative, see `recursion.write_damping`, or a mode too fast to be stepped.
    """
    (omega, damping), (step, highest) = modes, steps
    positions(values, lane, order)
    possible = True
    for r in range(omega.shape[0]):
        omega[r, lane] = np.sqrt(values[order[r], lane])
        damping[r, lane] = modal_damping(omega[r, lane], law.rayleigh, law.ratios[r])
        w = omega[r, lane] * step
        d = damping[r, lane] * step
        possible &= not is_fast(w, d, highest) and can_be_damped(w, d)
    if not possible:
        empty_modes(modes, lane)
    return possible


@jit
def empty_modes(modes, lane):
    """Write zeros into a lane without structure."""
    omega, damping = modes
    for r in range(omega.shape[0]):
        omega[r, lane] = damping[r, lane] = 0.0


@jit
def fill_lanes(lanes, modes, step, quantity, start):
    """Write coefficients and initial states of the modes of all lanes, and complete the feed-through.

    Parameters
    ----------
    lanes : Lanes
        With shapes times participation, and the feed-through.
    modes : tuple of arrays (m, LANES)
        omega and D.
    step, quantity
        As in `table.write_table`.
    start : float
        First sample of the excitation.
    """
    omega, damping = modes
    even_modes, n_sensors = lanes.states.shape[0] // 2, lanes.feed.shape[0]
    for r in range(omega.shape[0]):
        w, d = larger(load(omega, r) * step, splat(SMALLEST)), load(damping, r) * step
        if quantity == RELATIVE_DISPLACEMENT:
            output_q, output_p = splat(step * step), splat(0.0)
        elif quantity == RELATIVE_VELOCITY:
            output_q, output_p = splat(0.0), splat(step)
        else:
            output_q, output_p = 0.0 - w * w, 0.0 - d
        coefficients, after, after_2 = turned(hold_lanes(w * w, d), w, output_q, output_p)
        row = N_COEFFICIENTS * r
        store(lanes.coefficients, row, coefficients[0])
        store(lanes.coefficients, row + 1, coefficients[1])
        store(lanes.coefficients, row + 2, coefficients[2])
        store(lanes.coefficients, row + 3, coefficients[3])
        store(lanes.coefficients, row + 4, coefficients[4])
        store(lanes.states, 2 * r, 0.0 - after * start)
        store(lanes.states, 2 * r + 1, 0.0 - after_2 * start)
        for j in range(n_sensors):
            store(lanes.feed, j, load(lanes.feed, j) + load(lanes.shapes, j * even_modes + r) * after)
