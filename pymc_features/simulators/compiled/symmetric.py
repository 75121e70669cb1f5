"""Symmetric matrices in compiled code: Cholesky factors, and condensation as in `algebra.massless`."""

import numpy as np

from pymc_features.algebra.massless import INDEFINITE, MASSLESS, UNHELD
from pymc_features.simulators.compiled.jit import jit


@jit
def is_diagonal(matrix):
    """Whether all entries off the diagonal are zero."""
    for i in range(matrix.shape[0]):
        for j in range(i):
            if matrix[i, j] != 0.0 or matrix[j, i] != 0.0:
                return False
    return True


@jit
def factorise(matrix, factor, floor):
    """Write the Cholesky factor of a matrix into the lower half of another; False if it is not definite.

    `floor` is the share of its diagonal entry that a pivot must exceed.
    """
    for i in range(matrix.shape[0]):
        row = factor[i]
        for j in range(i + 1):
            other, total = factor[j], matrix[i, j]
            for k in range(j):
                total -= row[k] * other[k]
            if j < i:
                row[j] = total / other[j]
            elif floor * matrix[i, i] < total < np.inf:
                row[i] = np.sqrt(total)
            else:
                return False
    return True


@jit
def factorise_semidefinite(matrix, factor, independent):
    """As `factorise`, and whether a row (n,) depends on those before it; its column is then zero.

    False if the matrix has a negative eigenvalue.
    """
    for i in range(matrix.shape[0]):
        row, own = factor[i], np.sqrt(matrix[i, i])
        for j in range(i + 1):
            other, total = factor[j], matrix[i, j]
            for k in range(j):
                total -= row[k] * other[k]
            if j == i:
                independent[i] = total > MASSLESS * matrix[i, i]
            row[j] = 0.0
            if not independent[j]:
                if not abs(total) <= INDEFINITE * own * np.sqrt(matrix[j, j]):  # NaN too
                    return False
            elif j < i:
                row[j] = total / other[j]
            else:
                row[i] = np.sqrt(total)
    return True


@jit
def null_space(factor, independent, motions):
    """Write the null space, rows (k, n), of a matrix from its `factorise_semidefinite`.

    Each is one in its own dependent row, zero in the others.
    """
    dependent = np.flatnonzero(~independent)
    for r in range(dependent.size):
        motion, i = motions[r], dependent[r]
        motion[:i] = -factor[i, :i]
        motion[i:] = 0.0
        for k in range(i - 1, -1, -1):
            if independent[k]:
                multipliers = factor[k]
                motion[k] /= multipliers[k]
                for j in range(k):
                    motion[j] -= motion[k] * multipliers[j]
        motion[i] = 1.0


@jit
def condense(mass, stiffness):
    """Static condensation of motions without mass.

    Returns
    -------
    possible : bool
        False, the rest then undefined, where M is not positive semi-definite or K not definite on its null
        space.
    others : integer array (r,)
        Degrees of freedom with mass, r the rank of M.
    shapes : array (r, n)
        Rows: unit displacements of `others`, what has no mass following.
    motions : array (n - r, n)
        Rows: the null space of M, x' K y of any two 1 or 0.
    """
    n = mass.shape[0]
    factor, independent = np.zeros((n, n)), np.zeros(n, dtype=np.bool_)
    possible = factorise_semidefinite(mass, factor, independent)
    others = np.flatnonzero(independent)
    motions, shapes = np.empty((n - others.size, n)), np.zeros((others.size, n))
    if not possible:
        return False, others, shapes, motions
    null_space(factor, independent, motions)
    held, root = np.dot(np.dot(motions, stiffness), motions.T), np.zeros((len(motions), len(motions)))
    if not factorise(held, root, UNHELD):
        return False, others, shapes, motions
    for i in range(root.shape[0]):
        for j in range(i):
            motions[i] -= root[i, j] * motions[j]
        motions[i] /= root[i, i]
    shapes -= np.dot(np.dot(stiffness[others], motions.T), motions)
    for r in range(others.size):
        shapes[r, others[r]] += 1.0
    return True, others, shapes, motions
