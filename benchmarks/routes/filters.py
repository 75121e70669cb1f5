"""SciPy as a good engineer would write it: `eigh`, an exact `lfilter` for each mode, one matrix product.

The state of a mode under a first-order hold (`benchmarks.hold`) is eliminated, which leaves a filter of
second order from ground acceleration to the mode's share of the absolute acceleration.
"""

import numpy as np
from scipy.linalg import eigh
from scipy.signal import lfilter

from benchmarks.case import ALPHA, BETA
from benchmarks.hold import first_order_hold


def chain_matrix(stiffness):
    """Stiffness matrix of a chain [N/m], shape (n, n)."""
    above = np.append(stiffness[1:], 0.0)
    return np.diag(stiffness + above) - np.diag(above[:-1], 1) - np.diag(above[:-1], -1)


def modes(stiffness):
    """Frequencies [rad/s], damping ratios, and phi_r Gamma_r (n, modes) for masses of 1 kg."""
    eigenvalues, shapes = eigh(chain_matrix(stiffness))
    omega = np.sqrt(eigenvalues)
    return omega, 0.5 * (ALPHA / omega + BETA * omega), shapes * shapes.sum(axis=0)


def transfer(hold):
    """Numerators and denominators of the modal filters, each (modes, 3)."""
    (a11, a12), (a21, a22) = hold.phi
    c1, c2 = hold.out

    def outer(b):
        return c1 * b[0] + c2 * b[1]

    def inner(b):  # out times the constant part of the adjugate of z I - Phi
        return c1 * (a12 * b[1] - a22 * b[0]) + c2 * (a21 * b[0] - a11 * b[1])

    numerators = [outer(hold.after), outer(hold.now) + inner(hold.after), inner(hold.now)]
    denominators = [np.ones_like(a11), -(a11 + a22), a11 * a22 - a12 * a21]
    return np.array(numerators).T, np.array(denominators).T


def response(stiffness, ground, step):
    """Absolute acceleration of every degree of freedom, shape (n, N_D), from rest at sample 0."""
    omega, zeta, shapes = modes(stiffness)
    hold = first_order_hold(omega, zeta, step)
    numerators, denominators = transfer(hold)
    # delays that cancel the jump of the ground before sample 0: the structure is at rest there
    at_rest = hold.out[0] * hold.now[0] + hold.out[1] * hold.now[1]
    delays = ground[0] * np.array([-numerators[:, 0], at_rest - numerators[:, 1]]).T
    modal = np.empty((omega.size, ground.size))
    for r in range(omega.size):
        modal[r], _ = lfilter(numerators[r], denominators[r], ground, zi=delays[r])
    return shapes @ modal


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s)."""
    ground = case.fine_acceleration

    def evaluate():
        result = np.empty((len(case.stiffness), case.sensors.size))
        for e, stiffness in zip(result, case.stiffness, strict=True):
            misfit = response(stiffness, ground, case.step)[case.sensors]
            misfit -= case.observed
            np.einsum("jk,jk->j", misfit, misfit, out=e)
        return result / ground.size

    return evaluate
