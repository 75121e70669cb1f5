"""Symmetric matrices in compiled code: Cholesky factors, and condensation as in `algebra.massless`."""

import numpy as np

from pymc_features.algebra import INDEFINITE, MASSLESS, UNHELD
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
    """Write the null space, rows (k, n) of zeros before, of a matrix from its `factorise_semidefinite`.

    Each is one in its own dependent row, zero in the others.
    """
    r = 0
    for i in range(independent.size):
        if independent[i]:
            continue
        motion = motions[r]
        for j in range(i):
            motion[j] = -factor[i, j]
        for k in range(i - 1, -1, -1):
            if independent[k]:
                motion[k] /= factor[k, k]
                for j in range(k):
                    motion[j] -= motion[k] * factor[k, j]
        motion[i] = 1.0
        r += 1


@jit
def condense(mass, stiffness, independent):
    """Static condensation of motions without mass.

    Parameters
    ----------
    mass, stiffness : array (n, n)
    independent : bool (n,)
        Written: degrees of freedom with mass, as many as M has ranks.

    Returns
    -------
    possible : bool
        False, the rest then undefined, where M is not positive semi-definite or K not definite on its null
        space.
    shapes : array (r, n)
        Rows: unit displacements of the degrees of freedom with mass, what has none following.
    motions : array (n - r, n)
        Rows: the null space of M, x' K y of any two 1 or 0.
    """
    n = mass.shape[0]
    factor, rank = np.empty((n, n)), 0
    possible = factorise_semidefinite(mass, factor, independent)
    for i in range(n):
        rank += independent[i]
    motions, shapes = np.zeros((n - rank, n)), np.zeros((rank, n))
    if possible:
        null_space(factor, independent, motions)
        loads = np.dot(motions, stiffness)
        held, root = np.dot(loads, motions.T), np.empty((n - rank, n - rank))
        possible = factorise(held, root, UNHELD)
    if possible:
        for i in range(n - rank):
            for j in range(i + 1):
                share = root[i, j]
                for k in range(n):
                    if j < i:
                        motions[i, k] -= share * motions[j, k]
                        loads[i, k] -= share * loads[j, k]
                    else:
                        motions[i, k] /= share
                        loads[i, k] /= share
        static, r = np.dot(loads.T, motions), 0
        for i in range(n):
            if independent[i]:
                for k in range(n):
                    shapes[r, k] = (1.0 if k == i else 0.0) - static[i, k]
                r += 1
    return possible, shapes, motions
