"""Symmetric eigenproblems of a few hundred rows, of which only the lowest modes are wanted.

LAPACK reduces them to tridiagonal form, of which `tridiagonal` finds the pairs that are wanted; where two are
so close that their vectors are not orthogonal, all is left to LAPACK. That takes half the time of
`scipy.linalg.eigh`.
"""

import numpy as np
from scipy.linalg import LinAlgError, eigh, lapack

from pymc_features.simulators.reduced.tridiagonal import lowest_pairs

ORTHOGONAL = 1e-10  # largest product of two vectors that is neglected
MASSLESS = 1e-13  # an inverse eigenvalue below this times the largest is that of a motion without mass


def lowest(stiffness, mass, shift, count):
    """Lowest modes of K y = lambda M y, or of all rows where `count` is None.

    Parameters
    ----------
    stiffness, mass : array (r, r)
        K + shift M is positive definite. `mass` None stands for the identity.
    shift : float
    count : int or None

    Returns
    -------
    values : array (count,)
        Ascending; infinite for motions without mass.
    vectors : array (r, count)
        y' M y = 1, and y' K y = 1 for motions without mass.

    Raises
    ------
    LinAlgError
        If K + shift M is not positive definite, or an eigenvalue does not converge.
    """
    if mass is None:
        return spectrum(stiffness, count, False)
    factor, info = lapack.dpotrf(stiffness + shift * mass, lower=1, overwrite_a=1)
    if info == 0:
        inverse, info = lapack.dsygst(mass, factor, itype=1, lower=1)
    if info != 0:
        raise LinAlgError("not positive definite")
    inverses, vectors = spectrum(inverse, count, True)
    vectors, _ = lapack.dtrtrs(factor, vectors, lower=1, trans=1)
    has_mass = inverses > MASSLESS * inverses[0]
    values = np.full(inverses.size, np.inf)
    values[has_mass] = 1.0 / inverses[has_mass] - shift
    return values, vectors / np.sqrt(np.where(has_mass, inverses, 1.0))


def spectrum(matrix, count, from_above):
    """Lowest eigenvalues, ascending, or highest, descending, and their vectors; the lower half counts."""
    n = len(matrix)
    if count is None or count >= n:
        values, vectors = eigh(matrix, lower=True, driver="evd", check_finite=False)
        return (values[::-1], vectors[:, ::-1]) if from_above else (values, vectors)
    reflectors, diagonal, beside, scales, info = lapack.dsytrd(matrix, lower=1, lwork=32 * n)
    if info != 0 or not (np.isfinite(diagonal).all() and np.isfinite(beside).all()):
        raise LinAlgError("not finite")
    sign = -1.0 if from_above else 1.0
    values, rows = lowest_pairs(sign * diagonal, np.append(beside, 0.0), count)
    if from_above:
        rows[:, 1::2] *= -1.0  # -T has the same entries beside the diagonal in this basis
    if abs(rows @ rows.T - np.eye(count)).max() > ORTHOGONAL:
        first, last = (n - count, n - 1) if from_above else (0, count - 1)
        values, vectors = eigh(matrix, lower=True, subset_by_index=[first, last], check_finite=False)
        return (values[::-1], vectors[:, ::-1]) if from_above else (values, vectors)
    turned, _, _ = lapack.dormqr("L", "N", reflectors[1:, :-1], scales, rows.T[1:], 32 * n)
    return sign * values, np.vstack([rows.T[:1], turned])
