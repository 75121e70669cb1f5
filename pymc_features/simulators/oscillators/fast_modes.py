"""Modes too fast to be stepped: they follow their input.

Far below its frequency an oscillator q" + D q' + lambda q = -a has the solution q = -sum_k c_k a^(k), with

    lambda c_0 = 1,   lambda c_1 = -D c_0,   lambda c_k = -D c_(k-1) - c_(k-2),

whose terms fall like (f / f_r)^k. A mode above 0.3 of the rate at which a band-limited record is marched
follows it by the record and its four derivatives; errors over the peak, for content up to 0.45 of the
sampling rate and a mode at three times it, are 1e-4. Under straight lines a mode follows only where it cannot
be stepped at all: there only a itself counts.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    RELATIVE_VELOCITY,
)

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
