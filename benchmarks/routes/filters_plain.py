"""SciPy as one writes it first: generalised `eigh`, `cont2discrete` and `lfilter` for each mode."""

import numpy as np
from scipy.linalg import eigh
from scipy.signal import cont2discrete, lfilter, ss2tf

from benchmarks.case import ALPHA, BETA
from benchmarks.routes.filters import chain_matrix


def response(stiffness, ground, step):
    """Absolute acceleration of every degree of freedom, shape (n, N_D), from rest at sample 0."""
    mass = np.eye(len(stiffness))
    eigenvalues, shapes = eigh(chain_matrix(stiffness), mass)
    omega = np.sqrt(eigenvalues)
    zeta = 0.5 * (ALPHA / omega + BETA * omega)
    modal = np.empty((omega.size, ground.size))
    for r in range(omega.size):
        drag = -2.0 * zeta[r] * omega[r]
        a, b = np.array([[0.0, 1.0], [-(omega[r] ** 2), drag]]), np.array([[0.0], [-1.0]])
        c = np.array([[-(omega[r] ** 2), drag]])
        phi, gamma, _, d, _ = cont2discrete((a, b, c, [[0.0]]), step, method="foh")
        numerator, denominator = ss2tf(phi, gamma, c, d)
        # at rest at sample 0: the filter's delays cancel what a jump of the ground before it would leave
        after = np.linalg.solve(a @ a, phi - np.eye(2) - a * step) @ b / step
        at_rest = (c @ (gamma - phi @ after)).item()
        delays = ground[0] * np.array([-numerator[0, 0], at_rest - numerator[0, 1]])
        modal[r], _ = lfilter(numerator[0], denominator, ground, zi=delays)
    return (shapes * (shapes.T @ mass.sum(axis=1))) @ modal


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s)."""
    ground = case.fine_acceleration

    def evaluate():
        rows = [response(stiffness, ground, case.step)[case.sensors] for stiffness in case.stiffness]
        return np.array([((case.observed - row) ** 2).mean(axis=1) for row in rows])

    return evaluate
