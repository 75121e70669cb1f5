"""Change of the response of uncoupled modes, and of its misfit, along a direction: `gradient` transposed.

It is one combination each of f, df/dlambda and df/d(D h), the values of `gradient.Histories`.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.close_modes import close_modes
from pymc_features.simulators.oscillators.gradient import advance_histories, new_histories, write_response
from pymc_features.simulators.oscillators.misfit import take_change
from pymc_features.simulators.oscillators.recursion import BLOCK


class ModalChange(NamedTuple):
    """Changes of a structure along a direction, as the kernels over time see them.

    Attributes
    ----------
    stiffness, mass : array (m, m)
        Of Phi' K Phi and Phi' M Phi, at fixed Phi.
    load : array (m, d)
        Of Phi' L.
    shapes : array (s, m)
        Of S Phi, outside of the span of Phi.
    damping : array (m,)
        Of D.
    """

    stiffness: np.ndarray
    mass: np.ndarray
    load: np.ndarray
    shapes: np.ndarray
    damping: np.ndarray


@jit
def combine_change(system, change, close, step, combination):
    """Write the factors (3, d, s, padded) of f, df/dlambda and df/d(D h) in the change of the response.

    The factors of a pair of modes are opposite to the last bit: f_r and f_s cancel where they are nearly
    equal.

    Parameters
    ----------
    system : ModalSystem
    change : ModalChange
    close : array (m, m)
        Of `close_modes`.
    """
    omega, shapes, participation = system.omega, system.shapes, system.participation
    combination[:] = 0.0
    by_f, by_f_lambda, by_f_damping = combination
    for i in range(participation.shape[1]):
        for j in range(shapes.shape[0]):
            for r in range(omega.size):
                shape, gamma, scale = shapes[j, r], participation[r, i], change.mass[r, r]
                own = change.stiffness[r, r] - omega[r] * omega[r] * scale
                by_f[i, j, r] += gamma * change.shapes[j, r] + shape * (change.load[r, i] - gamma * scale)
                by_f_lambda[i, j, r] += shape * gamma * own
                by_f_damping[i, j, r] = shape * gamma * step * change.damping[r]
                for s in range(r):
                    both = gamma * shapes[j, s] + participation[s, i] * shape
                    mean = 0.5 * (omega[r] * omega[r] + omega[s] * omega[s])
                    pair = both * (change.stiffness[r, s] - mean * change.mass[r, s])
                    scaled = 0.5 * both * change.mass[r, s]
                    if close[r, s]:
                        by_f_lambda[i, j, r] += 0.5 * pair
                        by_f_lambda[i, j, s] += 0.5 * pair
                        pair = 0.0
                    else:
                        pair /= (omega[r] - omega[s]) * (omega[r] + omega[s])
                    by_f[i, j, r] += pair - scaled
                    by_f[i, j, s] -= pair + scaled


@jit
def march_change(system, law, feed, excitation, quantity, change, observed, history):
    """Write the change of the response along a direction into `history`, or return that of its misfit.

    Parameters
    ----------
    system, law, feed, excitation, quantity
        As in `modal_gradient`.
    change : ModalChange
    observed : array (s, u)
        Data; not read if there is a `history`.
    history : array (s, u) or (0, 0)

    Returns
    -------
    array (s,)
        Change of sum_k r_k^2; zero if there is a `history`.
    """
    n_sensors, total = system.shapes.shape[0], max(history.shape[1], observed.shape[1])
    step, stride = excitation.dt / excitation.substeps, excitation.stride
    close, _ = close_modes(system.omega, law, total * stride * step)
    modes = new_histories(system, law, excitation, quantity)
    combination = np.zeros((3, *modes.outputs.shape))
    combine_change(system, change, close, step, combination)
    part, response = np.empty((n_sensors, BLOCK)), np.empty((n_sensors, BLOCK))
    change_block, sums = np.empty((n_sensors, BLOCK)), np.zeros(n_sensors)
    for first in range(0, total, BLOCK):
        advance_histories(modes, excitation, first)
        change_block[:] = 0.0
        for k in range(3):
            for i in range(combination.shape[1]):
                np.dot(combination[k, i], modes.values[k, i, 1:].T, part)
                change_block += part
        if not history.size:
            write_response(modes, feed, part, response)
        take_change(response, change_block, first, observed, history, sums)
    return sums
