"""How the kept modes turn out of their span when the matrices change.

For a change of K and M, mode r moves by what it had no part of before,

    dphi_r = -(K - lambda_r M)^+ (dK - lambda_r dM) phi_r,

where ^+ is the inverse on the M-orthogonal complement of the kept modes: there K - lambda_r M is positive
definite, for the modes left out are higher. How the modes turn within their span is the matter of `pairs`.
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
        return shapes @ (shapes.T @ loads / gaps)
    moved = system.mass @ system.shapes
    residual = loads - moved @ (system.shapes.T @ loads)
    solution = np.zeros_like(residual)
    direction, energy, target = np.zeros_like(residual), None, None
    for _ in range(MAX_STEPS):
        better = system.factor.solve(residual)
        better -= system.shapes @ (moved.T @ better)
        found = np.maximum((residual * better).sum(axis=0), 0.0)
        if energy is None:
            target = TOLERANCE**2 * found
        if (found <= target).all():
            break
        ratio = np.zeros_like(found) if energy is None else _quotient(found, energy)
        energy = found
        direction = better + ratio * direction
        pushed = system.stiffness @ direction - (system.mass @ direction) * eigenvalues
        pushed -= moved @ (system.shapes.T @ pushed)
        size = np.where(found <= target, 0.0, _quotient(found, (direction * pushed).sum(axis=0)))
        solution += size * direction
        residual -= size * pushed
    return solution


def _quotient(a, b):
    """a / b, and 0 where b is not positive."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0.0)
