"""Component of the mode-shape derivatives orthogonal to the retained modes.

For a change of K and M, mode r changes outside the span of the kept modes by

    dphi_r = -(K - lambda_r M)^+ (dK - lambda_r dM) phi_r,

where ^+ is the inverse on the M-orthogonal complement of the kept modes: there K - lambda_r M is positive
definite, for the modes left out are higher, and what has no mass is part of it. Changes within that span are
treated in `close_modes`.
"""

import numpy as np

TOLERANCE = 1e-13  # of conjugate gradients, in the norm of the preconditioned residual
MAX_STEPS = 1000


def invert_outside(system, loads):
    """(K - lambda_r M)^+ b_r of all kept modes, array (n, m).

    Parameters
    ----------
    system : System
        With modes left out.
    loads : array (n, m)
        b_r.

    Notes
    -----
    By the other modes where they are at hand. Else by conjugate gradients on all right-hand sides at once,
    preconditioned with the factor of K + shift M: the convergence depends on the gap between the last kept
    frequency and the next, not on the number of degrees of freedom.
    """
    eigenvalues = system.omega**2
    if system.others is not None:
        omega, shapes = system.others
        gaps = (omega[:, None] - system.omega) * (omega[:, None] + system.omega)
        gaps[np.isinf(omega)] = 1.0  # without mass, and normalised by K
        return shapes @ (shapes.T @ loads / gaps)
    inertia = system.mass @ system.shapes
    residual = loads - inertia @ (system.shapes.T @ loads)
    solution = np.zeros_like(residual)
    direction, last_norm, target = np.zeros_like(residual), None, None
    for _ in range(MAX_STEPS):
        preconditioned = system.factor.solve(residual)
        preconditioned -= system.shapes @ (inertia.T @ preconditioned)
        norm = np.maximum((residual * preconditioned).sum(axis=0), 0.0)
        if last_norm is None:
            target, last_norm = TOLERANCE**2 * norm, np.full_like(norm, np.inf)
        if (norm <= target).all():
            break
        direction = preconditioned + _quotient(norm, last_norm) * direction
        product = system.stiffness @ direction - (system.mass @ direction) * eigenvalues
        product -= inertia @ (system.shapes.T @ product)
        size = np.where(norm <= target, 0.0, _quotient(norm, (direction * product).sum(axis=0)))
        solution += size * direction
        residual -= size * product
        last_norm = norm
    return solution


def _quotient(a, b):
    """a / b, and 0 where b is not positive."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0.0)
