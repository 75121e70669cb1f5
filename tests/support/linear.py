"""Linear structures with matrices of any kind."""

import numpy as np
from scipy import sparse

from pymc_features import AffineStructure, LinearStructure, ModalDamping

UNDAMPED = ModalDamping(0.0)


def of_matrices(mass, damping, stiffness):
    """The linear structure with M, C and K."""
    return LinearStructure(mass, stiffness=stiffness, damping=damping)


def noise(seed, shape=150):
    return np.random.default_rng(seed).normal(size=shape)


def random_structure(seed, n, *, damping=0.1, rank=None):
    """Full M, C and K with frequencies of 1 to 60 rad/s, C coupled and of any rank."""
    rng = np.random.default_rng(seed)
    mixing = rng.normal(size=(n, n))
    mass = mixing @ mixing.T / n + np.eye(n)
    root = np.linalg.cholesky(mass)
    basis = np.linalg.qr(rng.normal(size=(n, n)))[0]
    stiffness = root @ basis @ np.diag(np.geomspace(1.0, 3600.0, n)) @ basis.T @ root.T
    pots = rng.normal(size=(n, rank or n))
    return mass, damping * pots @ pots.T, 0.5 * (stiffness + stiffness.T)


def spring_chain(n, k, *, free=False):
    """Tridiagonal K of a uniform chain fixed at the base, or of one that floats."""
    diagonal = np.full(n, 2.0 * k)
    diagonal[-1] = k
    if free:
        diagonal[0] = k
    return sparse.diags_array([diagonal, np.full(n - 1, -k), np.full(n - 1, -k)], offsets=[0, 1, -1]).tocsc()


def as_linear(chain):
    """With the same damping object, and with its matrix."""
    mass, damping, stiffness = chain.matrices()
    return of_matrices(mass, chain.damping, stiffness), of_matrices(mass, damping, stiffness)


def affine(kind=np.asarray, **kwargs):
    lower, upper = np.diag([100.0, 0.0]), 80.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return AffineStructure(
        kind(np.diag([1.0, 2.0])),
        stiffness=kind(lower),
        damping=kind(np.diag([0.5, 0.0])),
        stiffness_terms=[kind(upper), None],
        mass_terms=[None, kind(np.diag([0.0, 1.0]))],
        damping_terms=[kind(0.01 * upper), None],
        theta=[1.0, 0.0],
        **kwargs,
    )


def meeting(omega, base, pots):
    """The factor of the dashpots at which two eigenvalues come closest, by bisection of a grid."""

    def distance(theta):
        zero, one = np.zeros((2, 2)), np.eye(2)
        drag = base + theta * pots
        values = np.linalg.eigvals(np.block([[zero, one], [-np.diag(omega**2), -drag]]))
        a, b = values[values.imag > 0]
        return abs(a - b)

    grid = np.linspace(0.0, 1.0, 201)
    for _ in range(12):
        best = min(range(201), key=lambda i: distance(grid[i]))
        grid = np.linspace(grid[max(best - 1, 0)], grid[min(best + 1, 200)], 201)
    return grid[100]
