"""Structures as uncoupled modes, the form in which the kernels over time take them."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION


class ModalSystem(NamedTuple):
    """Uncoupled modes x = Phi q under d inputs: q_r" + D_r q_r' + omega_r^2 q_r = -sum_i Gamma_ri a_i(t).

    Attributes
    ----------
    omega : array (m,)
        [rad/s].
    damping : array (m,)
        D = 2 zeta omega [1/s].
    shapes : array (s, m)
        S Phi, mass-normalised mode shapes at the outputs.
    participation : array (m, d)
        Gamma.
    """

    omega: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray
    participation: np.ndarray


class DampingLaw(NamedTuple):
    """Classical damping, D = alpha + beta omega^2 + 2 ratio omega.

    Attributes
    ----------
    rayleigh : array (2,)
        alpha [1/s] and beta [s].
    ratios : array (>= m,)
        Damping ratios [-] of the modes, added to those of Rayleigh's.
    """

    rayleigh: np.ndarray
    ratios: np.ndarray


@jit
def feed_through(motion, by_forces, by_modes, quantity, complete):
    """What stands before one input in the response of one output, J of Eq. (24).

    Parameters
    ----------
    motion : float
        S iota: displacement of the output under a unit displacement of the support.
    by_forces : float
        S Phi Phi' forces.
    by_modes : float
        S Phi Gamma.
    quantity : int
        Position in `QUANTITIES`.
    complete : bool
        Whether all modes are kept: their sum is then known without its rounding error. With modes left out
        the absolute acceleration keeps the ground's share of them.
    """
    if quantity not in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION):
        return 0.0
    if complete:
        by_modes = motion - by_forces
    return (motion if quantity == ABSOLUTE_ACCELERATION else 0.0) - by_modes


@jit
def write_feed(system, support_motion, quantity, complete, by_forces, feed):
    """Write `feed_through` of all inputs and outputs, (s, d).

    Parameters
    ----------
    system : ModalSystem
    support_motion : array (s, d)
        S iota.
    by_forces : array (s d,)
        S Phi Phi' forces.
    """
    for j in range(feed.shape[0]):
        for i in range(feed.shape[1]):
            by_modes = 0.0
            for r in range(system.omega.size):
                by_modes += system.shapes[j, r] * system.participation[r, i]
            own = by_forces[j * feed.shape[1] + i]
            feed[j, i] = feed_through(support_motion[j, i], own, by_modes, quantity, complete)
