"""NumPy with arrays of particles: a Python loop over time, the output by a batched matrix product."""

import numpy as np

from benchmarks.case import ALPHA, BETA
from benchmarks.hold import first_order_hold

BLOCK = 128  # output steps held at a time


def population_modes(case):
    """Modes of every particle by one stacked `eigh`: (P, m), (P, m), (P, s, m)."""
    stiffness = case.stiffness
    above = np.pad(stiffness[:, 1:], ((0, 0), (0, 1)))
    matrices = np.zeros((*stiffness.shape, case.n_dof))
    i = np.arange(case.n_dof)
    matrices[:, i, i] = stiffness + above
    matrices[:, i[1:], i[:-1]] = matrices[:, i[:-1], i[1:]] = -above[:, :-1]
    eigenvalues, shapes = np.linalg.eigh(matrices)
    omega = np.sqrt(eigenvalues)
    shapes *= shapes.sum(axis=1, keepdims=True)
    return omega, 0.5 * (ALPHA / omega + BETA * omega), shapes[:, case.sensors]


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s)."""
    ground = case.fine_acceleration

    def evaluate():
        omega, zeta, shapes = population_modes(case)
        hold = first_order_hold(omega, zeta, case.step)
        state = np.zeros((2, *omega.shape))
        modal = np.empty((*omega.shape, BLOCK))
        errors = np.zeros(shapes.shape[:2])
        for first in range(0, ground.size, BLOCK):
            count = min(BLOCK, ground.size - first)
            for b in range(count):
                if first + b > 0:
                    state = _step(hold, state, ground[first + b - 1], ground[first + b])
                modal[..., b] = hold.out[0] * state[0] + hold.out[1] * state[1]
            misfit = shapes @ modal[..., :count]
            misfit -= case.observed[:, first : first + count]
            errors += np.einsum("pjk,pjk->pj", misfit, misfit)
        return errors / ground.size

    return evaluate


def _step(hold, state, before, now):
    """Carry the modal states of all particles through one step."""
    q, p = state
    return [
        hold.phi[i][0] * q + hold.phi[i][1] * p + (hold.now[i] * before + hold.after[i] * now) for i in (0, 1)
    ]
