"""Pairs of complex modes as the march takes them: each twice, seen by its displacement and by its velocity.

Both poles of a pair make up an oscillator q" + d q' + s q = -a with s their product and d less their sum, and
what a sensor sees of the pair is a combination of q and q'.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import splat, store
from pymc_features.simulators.compiled.vector_memory import new_vectors
from pymc_features.simulators.eigen.complex_modes import (
    PANEL,
    mode_places,
    pole_of,
    settle_panel,
    start_panel,
)
from pymc_features.simulators.eigen.pair_numbers import times
from pymc_features.simulators.eigen.residues import (
    CANCELLING,
    add_to_sums,
    at_sensor,
    check_sums,
    input_factor,
)
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY
from pymc_features.simulators.oscillators.modal_lanes import clear


class Pairs(NamedTuple):
    """Pairs of structures, one in each lane.

    Attributes
    ----------
    stiffness, drag : array (m, LANES)
        s and d.
    shapes : array (2 s m, LANES)
        Before q and q' of pair r at sensor j, in rows 2 (j m + r) ...
    forced : array (s, LANES)
        S iota less S Phi Gamma.
    """

    stiffness: np.ndarray
    drag: np.ndarray
    shapes: np.ndarray
    forced: np.ndarray


@jit
def new_oscillator_pairs(m, n_sensors):
    """Room for m pairs."""
    return Pairs(new_vectors(m), new_vectors(m), new_vectors(2 * n_sensors * m), new_vectors(n_sensors))


@jit
def write_shares(pairs, at, r, p, quantity):
    """Write pair r, place p of the panel, and what sensors see of it; add it to the sums that are checked.

    `at` are the places of the complex modes.
    """
    (a, b), square = pole_of(at, p)
    stiffness, drag, factor = a * a - square * (b * b), 0.0 - 2.0 * a, input_factor(at, p)
    store(pairs.stiffness, r, stiffness)
    store(pairs.drag, r, drag)
    m = pairs.stiffness.shape[0]
    for j in range(pairs.forced.shape[0]):
        residue = times(at_sensor(at, j, p), factor, square)
        speed, size = 2.0 * residue[0], 2.0 * (a * residue[0] - square * (b * residue[1]))
        by_q, by_v = 0.0 - size, speed
        rate = by_q - drag * by_v  # of q' in the velocity, and of the input in the acceleration
        add_to_sums(at, j, (a, b, square), residue)
        if quantity != RELATIVE_DISPLACEMENT:
            by_q, by_v = 0.0 - stiffness * by_v, rate
            if quantity != RELATIVE_VELOCITY:
                by_q, by_v = 0.0 - stiffness * by_v, by_q - drag * by_v
        store(pairs.shapes, 2 * (j * m + r), by_q)
        store(pairs.shapes, 2 * (j * m + r) + 1, by_v)


@jit
def write_pairs(pairs, modes, n_sensors, quantity):
    """Find and write the complex modes of all lanes; `modes.is_good` tells which came out right."""
    m, at = modes.omega.shape[0], mode_places(modes)
    for i in range(3 * n_sensors):
        store(modes.sums, i, splat(0.0))
    for first in range(0, m, PANEL):
        start_panel(modes, first)
        settle_panel(modes, first)
        for p in range(min(PANEL, m - first)):
            write_shares(pairs, at, first + p, p, quantity)
    check_sums(modes, n_sensors, CANCELLING)


@jit
def fill_lanes(lot, pairs, is_good):
    """Write the pairs of good lanes, `is_good` (1, LANES), as displacements, then as velocities."""
    m = pairs.stiffness.shape[0]
    for lane in range(lot.is_there.size):
        lot.is_there[lane] = is_good[0, lane] > 0.0
        if not lot.is_there[lane]:
            clear(lot, lane)
            continue
        for r in range(2 * m):
            lot.squares[r, lane], lot.damping[r, lane] = pairs.stiffness[r % m, lane], pairs.drag[r % m, lane]
            lot.moves[r, lane] = lot.participation[r, lane] = 1.0
            for j in range(lot.n_sensors):
                lot.shapes[j * lot.n_all + r, lane] = pairs.shapes[2 * (j * m + r % m) + r // m, lane]
        for j in range(lot.n_sensors):
            lot.forced[j, lane] = pairs.forced[j, lane]
