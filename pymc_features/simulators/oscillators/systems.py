"""Modes of many structures, in the form in which tables are asked."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit


class Systems(NamedTuple):
    """Uncoupled modes of many structures at the outputs, as a `ModalSystem` of each.

    Attributes
    ----------
    valid : bool array (p,)
        Whether there is a structure whose modes all are stepped; the rest is undefined where not.
    omega, damping : array (p, m)
        [rad/s] and D [1/s].
    shapes : array (p, s, m)
    participation : array (p, m, d)
    feed : array (p, s, d)
        What stands before the inputs in the response.
    """

    valid: np.ndarray
    omega: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray
    participation: np.ndarray
    feed: np.ndarray


@jit
def new_systems(n_particles, n_sensors, n_modes, n_inputs):
    """Room for the modes of structures; none of them valid."""
    return Systems(
        np.zeros(n_particles, dtype=np.bool_),
        np.zeros((n_particles, n_modes)),
        np.zeros((n_particles, n_modes)),
        np.zeros((n_particles, n_sensors, n_modes)),
        np.zeros((n_particles, n_modes, n_inputs)),
        np.zeros((n_particles, n_sensors, n_inputs)),
    )


@jit
def put_modes(systems, p, modes, feed):
    """Write the `ModalSystem` and the feed-through (s, d) of structure p."""
    systems.valid[p] = True
    for r in range(modes.omega.size):  # assignments of arrays compile long, see `copy_entries`
        systems.omega[p, r], systems.damping[p, r] = modes.omega[r], modes.damping[r]
        for j in range(feed.shape[0]):
            systems.shapes[p, j, r] = modes.shapes[j, r]
        for d in range(feed.shape[1]):
            systems.participation[p, r, d] = modes.participation[r, d]
    for j in range(feed.shape[0]):
        for d in range(feed.shape[1]):
            systems.feed[p, j, d] = feed[j, d]
