"""The chain rule between reduced matrices and parameters: gradients by theta.

The kernels over time know the structure by its reduced matrices Phi' A Phi, its load Phi' L and its outputs
S Phi, the modes Phi being held fixed. Derivatives by these are brought to the parameters here, together with
what the modes that are left out add (`complement`). Of n^2 derivatives by the entries of a matrix only those
are formed that the structure stores.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.linear.complement import invert_outside


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
    """As `stored_products`, for a pattern."""
    entries = np.empty(rows.size)
    for column in range(starts.size - 1):
        for e in range(starts[column], starts[column + 1]):
            total = 0.0
            for k in range(left.shape[1]):
                total += left[rows[e], k] * right[column, k]
            entries[e] = total
    return entries
