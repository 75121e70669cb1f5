"""The chain rule between reduced matrices and parameters: gradients by theta.

The kernels over time know the structure by its reduced matrices Phi' A Phi, its load Phi' L and its outputs
S Phi, the modes Phi being held fixed. Derivatives by these are brought to the parameters here, together with
what the modes that are left out add (`complement`). Of n^2 derivatives by the entries of a matrix only those
are formed that the structure stores.

Component of the mode-shape derivatives orthogonal to the retained modes.

For a change of K and M, mode r changes outside the span of the kept modes by

    dphi_r = -(K - lambda_r M)^+ (dK - lambda_r dM) phi_r,

where ^+ is the inverse on the M-orthogonal complement of the kept modes: there K - lambda_r M is positive
definite, for the modes left out are higher, and what has no mass is part of it. Changes within that span are
treated in `oscillators.reduction`.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.compiled.jit import jit

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


class Cotangent(NamedTuple):
    """Derivatives of a number L with respect to what the kernels over time know.

    Attributes
    ----------
    stiffness, mass : array (m, m)
        By Phi' K Phi and Phi' M Phi, at fixed Phi.
    damping : array (m, m) or None
        By Phi' C Phi; None if the damping is classical.
    load : array (m, d)
        By Phi' L, L = M influence - forces.
    shapes : array (n, m)
        By Phi, outside of its span.
    rayleigh, ratios : array (2,), (k,)
    """

    stiffness: np.ndarray
    mass: np.ndarray
    damping: np.ndarray | None
    load: np.ndarray
    shapes: np.ndarray
    rayleigh: np.ndarray
    ratios: np.ndarray


def to_parameters(a, system, cotangent):
    """Gradient of L by theta, rayleigh and ratios.

    With G_A the derivative by the reduced Phi' A Phi, the entries of A have the derivatives Phi G_A Phi'; M
    has those by the load as well, and by K and M the modes leave their span, see `complement`.
    """
    given, shapes = a.parameters, system.shapes
    grad_theta = np.zeros(given.theta.size)
    left_of_stiffness, left_of_mass = shapes @ cotangent.stiffness, shapes @ cotangent.mass
    if shapes.shape[1] < shapes.shape[0] and not given.has_constant_modes:
        outside = invert_outside(system, cotangent.shapes)
        left_of_stiffness -= outside
        left_of_mass += outside * system.omega**2
    if given.stiffness.shape[0] > 1:
        grad_theta += given.stiffness[1:] @ stored_products(given, left_of_stiffness, shapes)
    if given.mass.shape[0] > 1:
        left = np.hstack([left_of_mass, shapes @ cotangent.load])
        grad_theta += given.mass[1:] @ stored_products(given, left, np.hstack([shapes, given.influence]))
    if given.damping.shape[0] > 1:
        grad_theta += given.damping[1:] @ stored_products(given, shapes @ cotangent.damping, shapes)
    return grad_theta, cotangent.rayleigh, cotangent.ratios


def stored_products(parameters, left, right):
    """Entries (e,) of left right' at the places of the pattern; two arrays (n, k)."""
    if parameters.is_dense:
        return (left @ right.T).ravel()
    pattern = writable(parameters.rows, np.int64), writable(parameters.starts, np.int64)
    return sparse_products(writable(left), writable(right), *pattern)


@jit
def sparse_products(left, right, rows, starts):
    """Entries (e,) of left right' at the places of a sparse pattern; two arrays (n, k)."""
    entries = np.empty(rows.size)
    for column in range(starts.size - 1):
        for e in range(starts[column], starts[column + 1]):
            total = 0.0
            for k in range(left.shape[1]):
                total += left[rows[e], k] * right[column, k]
            entries[e] = total
    return entries
