"""Pairs of complex modes, one structure in each vector lane, put into `Lanes` for their march.

A pair is an oscillator q" + D q' + w^2 q = -a with w^2 = lambda_1 lambda_2 and D = -(lambda_1 + lambda_2), of
which the sensors see a displacement c_q q + c_v q', a velocity, or an acceleration, each a combination of q
and q' again and of the input. The recursion is that of `recursion`, with y = x - b1 a as in `population`:
six products for a pair and step, and two columns for each sensor.
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import load, splat, store, where_less
from pymc_features.simulators.compiled.vector_memory import read_lanes, write_lanes
from pymc_features.simulators.eigen.complex_modes import (
    PANEL,
    mode_places,
    pole_of,
    settle_panel,
    start_panel,
)
from pymc_features.simulators.eigen.filling import hold_lanes
from pymc_features.simulators.eigen.pair_numbers import times
from pymc_features.simulators.eigen.residues import (
    CANCELLING,
    add_to_sums,
    at_sensor,
    check_sums,
    input_factor,
)
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY
from pymc_features.simulators.oscillators.lanes import N_OF_PAIR


@jit
def fill_pairs(lanes, modes, n_sensors, step, quantity, start):
    """Find the complex modes of all lanes, and write their coefficients, shapes and initial states.

    Parameters
    ----------
    lanes : Lanes
        Of pairs, with the feed-through, to which is added what stands before a[k] in the states.
    modes : ComplexLanes
        Whose `is_good` tells, afterwards, which lanes came out right.
    n_sensors : int
    step, quantity, start
        As in `filling.fill_lanes`.
    """
    at, m = mode_places(modes), modes.omega.shape[0]
    for i in range(3 * n_sensors):
        store(modes.sums, i, splat(0.0))
    for first in range(0, m, PANEL):
        start_panel(modes, first)
        settle_panel(modes, first)
        for p in range(min(PANEL, m - first)):
            after = write_recursion(lanes, modes, first + p, p, step, start)
            write_shares(lanes, at, (first + p, p), after, step, quantity)
    check_sums(modes, n_sensors, CANCELLING)


@jit
def write_recursion(lanes, modes, r, p, step, start):
    """Write coefficients and initial state of pair r, mode p of the panel; returns b1."""
    a, b, square = load(modes.poles, 3 * p), load(modes.poles, 3 * p + 1), load(modes.poles, 3 * p + 2)
    stiffness, drag, is_good = a * a - square * (b * b), 0.0 - 2.0 * a, load(modes.is_good, 0)
    stiffness = where_less(splat(0.0), is_good, stiffness, splat(0.0))  # halving would not end at infinity
    drag = where_less(splat(0.0), is_good, drag, splat(0.0))
    qq, qp, pq, pp, now_q, now_p, next_q, next_p = hold_lanes(stiffness * (step * step), drag * step)
    row = N_OF_PAIR * r
    store(lanes.coefficients, row, qq)
    store(lanes.coefficients, row + 1, qp)
    store(lanes.coefficients, row + 2, qq * next_q + qp * next_p + now_q)
    store(lanes.coefficients, row + 3, pq)
    store(lanes.coefficients, row + 4, pp)
    store(lanes.coefficients, row + 5, pq * next_q + pp * next_p + now_p)
    store(lanes.states, 2 * r, 0.0 - next_q * start)
    store(lanes.states, 2 * r + 1, 0.0 - next_p * start)
    return next_q, next_p


@jit
def write_shares(lanes, at, place, after, step, quantity):
    """Write what the sensors see of a pair, and add it to the sums that are checked.

    Parameters
    ----------
    at : ModePlaces
        Of the complex modes.
    place : tuple of int
        Number of the pair, its place in the panel.
    after : tuple
        From `write_recursion`.
    """
    (r, p), ((a, b), square), even_modes = place, pole_of(at, place[1]), lanes.states.shape[0] // 2
    shapes, feeds = lanes.shapes.ctypes.data, lanes.feed.ctypes.data
    stiffness, drag, factor = a * a - square * (b * b), 0.0 - 2.0 * a, input_factor(at, p)
    for j in range(lanes.data.shape[0]):
        residue = times(at_sensor(at, j, p), factor, square)
        speed, size = 2.0 * residue[0], 2.0 * (a * residue[0] - square * (b * residue[1]))
        by_q, by_v = 0.0 - size, speed
        rate = by_q - drag * by_v  # of q' in the velocity, and of the input in the acceleration
        add_to_sums(at, j, (a, b, square), residue)
        if quantity != RELATIVE_DISPLACEMENT:
            by_q, by_v = 0.0 - stiffness * by_v, rate
            if quantity != RELATIVE_VELOCITY:
                by_q, by_v = 0.0 - stiffness * by_v, by_q - drag * by_v
        by_q, by_v = by_q * (step * step), by_v * step
        write_lanes(shapes, 2 * (j * even_modes + r), by_q)
        write_lanes(shapes, 2 * (j * even_modes + r) + 1, by_v)
        write_lanes(feeds, j, read_lanes(feeds, j) + by_q * after[0] + by_v * after[1])
