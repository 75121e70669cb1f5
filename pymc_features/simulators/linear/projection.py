"""Between parameters and modes: gradients with respect to theta, and directions of it.

The kernels over time know the structure by its reduced matrices Phi' A Phi, its load Phi' L and its outputs
S Phi, the modes Phi being held fixed. What they say of these is brought to the parameters here, together with
what the modes that are left out add (`complement`). Of n^2 derivatives by the entries of a matrix only those
are formed that the structure stores.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.algebra import assemble
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


class Motion(NamedTuple):
    """Changes of Phi' K Phi, Phi' M Phi, Phi' C Phi (m, m) and Phi' L (m, d), and of Phi outside its span.

    The first four are at fixed Phi; `shapes` (n, m).
    """

    stiffness: np.ndarray
    mass: np.ndarray
    damping: np.ndarray
    load: np.ndarray
    shapes: np.ndarray


def to_parameters(a, system, cotangent):
    """Gradient of L by theta, rayleigh and ratios."""
    shapes, theta = system.shapes, np.zeros(a.theta.size)
    by_stiffness, by_mass = shapes @ cotangent.stiffness, shapes @ cotangent.mass
    if shapes.shape[1] < shapes.shape[0] and max(a.stiffness.shape[0], a.mass.shape[0]) > 1:
        turned = invert_outside(system, cotangent.shapes)
        by_stiffness -= turned
        by_mass += turned * system.omega**2
    if a.stiffness.shape[0] > 1:
        theta += a.stiffness[1:] @ stored_products(a, by_stiffness, shapes)
    if a.mass.shape[0] > 1:
        left = np.hstack([by_mass, shapes @ cotangent.load])
        theta += a.mass[1:] @ stored_products(a, left, np.hstack([shapes, a.influence]))
    if a.damping.shape[0] > 1:
        theta += a.damping[1:] @ stored_products(a, shapes @ cotangent.damping, shapes)
    return theta, cotangent.rayleigh, cotangent.ratios


def stored_products(a, left, right):
    """Entries (e,) of left right' at the places of the pattern; two arrays (n, k)."""
    if not a.starts.size:
        return (left @ right.T).ravel()
    return sparse_products(
        writable(left), writable(right), writable(a.rows, np.int64), writable(a.starts, np.int64)
    )


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


def move(a, system, d_theta):
    """What a direction of theta does to the reduced matrices, see `Motion`."""
    shapes = system.shapes
    n, m = shapes.shape
    by_stiffness, by_mass, by_damping, pushed = (
        _change(a, stack, d_theta, vectors)
        for stack, vectors in (
            *((a.stiffness, shapes), (a.mass, shapes)),
            *((a.damping, shapes), (a.mass, a.influence)),
        )
    )
    turned = np.zeros((n, m))
    if m < n and max(a.stiffness.shape[0], a.mass.shape[0]) > 1:
        turned = -invert_outside(system, by_stiffness - by_mass * system.omega**2)
    return Motion(*(shapes.T @ v for v in (by_stiffness, by_mass, by_damping, pushed)), turned)


def _change(a, stack, d_theta, vectors):
    """sum_i dtheta_i A_i times vectors (n, k)."""
    if stack.shape[0] < 2:
        return np.zeros(vectors.shape)
    entries = (d_theta @ stack[1:])[None]
    return assemble(entries, d_theta[:0], a.rows, a.starts, vectors.shape[0]) @ vectors
