"""Structures as uncoupled modes, the form in which the kernels over time take them.

Modes too fast to be stepped: they follow their input.

Far below its frequency an oscillator q" + D q' + lambda q = -a has the solution q = -sum_k c_k a^(k), with

    lambda c_0 = 1,   lambda c_1 = -D c_0,   lambda c_k = -D c_(k-1) - c_(k-2),

whose terms fall like (f / f_r)^k. A mode above 0.3 of the rate at which a band-limited record is marched
follows it by the record and its four derivatives; errors over the peak, for content up to 0.45 of the
sampling rate and a mode at three times it, are 1e-4. Under straight lines a mode follows only where it cannot
be stepped at all: there only a itself counts.

Damping of modes.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    RELATIVE_VELOCITY,
)


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


N_ORDERS = 5  # a and four derivatives
FAST = 0.6 * np.pi  # omega h of a mode that follows a band-limited record
COUPLED = 4.0 * np.pi  # the same of modes that the damping couples, which follow the record alone
STIFFEST = 1e6  # omega h of a mode that follows straight lines, and D h of one that can be stepped


@jit
def highest_step(excitation):
    """omega h from where a mode follows its input."""
    return STIFFEST if excitation.direct.size == 0 else FAST


@jit
def is_fast(w, d, highest):
    """Whether a mode of omega h and D h follows its input."""
    return w > highest or d >= STIFFEST


@jit
def has_fast(system, step, highest):
    """Whether a mode of a `ModalSystem` follows its input."""
    found = False
    for r in range(system.omega.size):
        found |= is_fast(system.omega[r] * step, system.damping[r] * step, highest)
    return found


@jit
def highest_coupled_step(excitation):
    """omega h from where a mode that a damping matrix couples to others is left out of the march.

    The ground moves it along then, as the modes that `n_modes` leaves out.
    """
    return STIFFEST if excitation.direct.size == 0 else COUPLED


@jit
def write_following(omega, damping, slope, quantity, factors):
    """Write what stands before a, a', ... in the output f of a mode, in df/dlambda and in df/dD, (3, 5).

    The output of accelerations is q", relative to the input; `slope` is dD/dlambda along the law of damping,
    which is in df/dlambda.
    """
    square, order = omega * omega, 2
    if quantity == RELATIVE_VELOCITY:
        order = 1
    elif quantity != ABSOLUTE_ACCELERATION and quantity != RELATIVE_ACCELERATION:
        order = 0
    c, by_square, by_damping = np.zeros(N_ORDERS), np.zeros(N_ORDERS), np.zeros(N_ORDERS)
    for k in range(N_ORDERS):
        value, change, drag = (1.0 if k == 0 else 0.0), 0.0, 0.0
        if k > 0:
            value -= damping * c[k - 1]
            change -= damping * by_square[k - 1]
            drag -= c[k - 1] + damping * by_damping[k - 1]
        if k > 1:
            value -= c[k - 2]
            change -= by_square[k - 2]
            drag -= by_damping[k - 2]
        c[k] = value / square
        by_square[k], by_damping[k] = (change - c[k]) / square, drag / square
    factors[:] = 0.0
    for k in range(N_ORDERS - order):
        factors[0, k + order] = -c[k]
        factors[1, k + order] = -(by_square[k] + slope * by_damping[k])
        factors[2, k + order] = -by_damping[k]


@jit
def modal_damping(omega, rayleigh, ratio):
    """D = 2 zeta omega = alpha + beta omega^2 + 2 ratio omega [1/s] of a mode, Eq. (19)."""
    return rayleigh[0] + rayleigh[1] * omega * omega + 2.0 * ratio * omega


@jit
def write_damping(omega, rayleigh, ratios, step, damping):
    """Write D of all modes (m,); False if one is negative, or too large to be stepped at such a frequency."""
    for r in range(omega.size):
        damping[r] = modal_damping(omega[r], rayleigh, ratios[r])
        if not can_be_damped(omega[r] * step, damping[r] * step):
            return False
    return True


@jit
def can_be_damped(w, d):
    """Whether a mode of omega h and D h has a response; NaN has none.

    One that cannot be stepped must relax within a step, D / omega^2 < h, to follow its input.
    """
    return d >= 0.0 and d < np.inf and (d < STIFFEST or d < w * w)
