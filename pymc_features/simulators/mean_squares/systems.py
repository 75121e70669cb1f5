"""Modes of many structures, in the form in which tables are asked."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.modal_system import feed_through


class Systems(NamedTuple):
    """Uncoupled modes of many structures at the outputs, as a `ModalSystem` of each.

    Attributes
    ----------
    valid : bool array (p,)
        Whether there is a structure; the rest is undefined where not.
    omega, damping : array (p, m)
        [rad/s] and D [1/s].
    shapes : array (p, s, m)
    participation : array (p, m, d)
    feed : array (p, s, d)
        What stands before the inputs in the response.
    in_pairs : bool
        Whether each mode is there twice, first half of the m and second half: seen by its displacement and by
        its velocity, whatever the quantity, as complex modes are.
    """

    valid: np.ndarray
    omega: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray
    participation: np.ndarray
    feed: np.ndarray
    in_pairs: bool


@jit
def new_systems(n_particles, n_sensors, n_modes, n_inputs, in_pairs):
    """Room for the modes of structures; none of them valid."""
    return Systems(
        np.zeros(n_particles, dtype=np.bool_),
        np.zeros((n_particles, n_modes)),
        np.zeros((n_particles, n_modes)),
        np.zeros((n_particles, n_sensors, n_modes)),
        np.zeros((n_particles, n_modes, n_inputs)),
        np.zeros((n_particles, n_sensors, n_inputs)),
        in_pairs,
    )


@jit
def put_modes(systems, p, modes, feed):
    """Write the `ModalSystem` and the feed-through (s, d) of structure p."""
    systems.valid[p] = True
    systems.omega[p], systems.damping[p] = modes.omega, modes.damping
    systems.shapes[p], systems.participation[p], systems.feed[p] = modes.shapes, modes.participation, feed


@jit
def put_lane(systems, p, kept, shapes, outputs):
    """Write structure p with one input, whose modes are in a vector lane.

    Parameters
    ----------
    kept : tuple of arrays (m, LANES)
        omega and D.
    shapes : tuple
        Products (n w, LANES) of the mode shapes with the outputs, with forces if there are any, and their
        participation; the positions (n,) of the modes; and the lane.
    outputs : tuple
        Displacement (s,) of the outputs under a unit displacement of the support, and the quantity.
    """
    (vectors, order, lane), (motion, quantity) = shapes, outputs
    (n_sensors, m), width = systems.shapes[p].shape, vectors.shape[0] // order.size
    systems.valid[p] = True
    for r in range(m):
        row = order[r] * width
        systems.omega[p, r], systems.damping[p, r] = kept[0][r, lane], kept[1][r, lane]
        systems.participation[p, r, 0] = vectors[row + width - 1, lane]
        for j in range(n_sensors):
            systems.shapes[p, j, r] = vectors[row + j, lane]
    for j in range(n_sensors):
        by_modes, by_forces = 0.0, 0.0
        for r in range(m):
            row = order[r] * width
            by_modes += vectors[row + j, lane] * vectors[row + width - 1, lane]
            if width > n_sensors + 1:
                by_forces += vectors[row + j, lane] * vectors[row + n_sensors, lane]
        systems.feed[p, j, 0] = feed_through(motion[j], by_forces, by_modes, quantity, m == order.size)
