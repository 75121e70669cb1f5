"""Factorisations that tell definite matrices: Cholesky, and of sparse ones the pivots.

By Sylvester's law of inertia the pivots of A = L D L' have the signs of the eigenvalues of A. A positive
definite matrix can be eliminated along its diagonal in any order; SuperLU in symmetric mode does so, and
a pivot off the diagonal or below zero says that the matrix is not definite.
"""

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve, cholesky
from scipy.sparse.linalg import SuperLU, splu

ZERO_STIFFNESS = 1e-8  # |omega^2| below this times trace(K) / trace(M) counts as rounding


def eliminate(matrix) -> SuperLU | None:
    """Symmetric elimination of a sparse matrix; None where it needs a pivot off the diagonal."""
    try:
        factor = splu(
            sparse.csc_matrix(matrix),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError:  # a zero pivot
        return None
    return factor if np.array_equal(factor.perm_r, factor.perm_c) else None


def is_definite(matrix) -> bool:
    """Whether a symmetric matrix is positive definite to working precision."""
    return definite_factor(matrix) is not None


def definite_factor(matrix, floor: float = 0.0):
    """The factor of a positive definite matrix (`SuperLU` if sparse); None if it is not definite.

    `floor` is the share of its diagonal entry that a pivot must exceed.
    """
    if sparse.issparse(matrix):
        factor = eliminate(matrix)
    else:
        try:
            factor = cholesky(matrix, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            factor = None
    if factor is None or not (pivots(factor) > floor * matrix.diagonal()).all():
        return None
    return factor


def pivots(factor) -> np.ndarray:
    """Pivots (n,) of a factor from `eliminate` or `cholesky`, by the rows of the matrix."""
    if isinstance(factor, SuperLU):
        return factor.U.diagonal()[factor.perm_c]
    return factor.diagonal() ** 2


def solve(factor, loads: np.ndarray) -> np.ndarray:
    """A^-1 b by a factor of A from `definite_factor`."""
    return factor.solve(loads) if isinstance(factor, SuperLU) else cho_solve((factor, True), loads)


def count_below(mass, stiffness, eigenvalue: float) -> int | None:
    """Number of omega^2 of sparse matrices below a value, by inertia; None where it cannot be told."""
    factor = eliminate(stiffness - eigenvalue * mass)
    return None if factor is None else int((factor.U.diagonal() < 0.0).sum())


def spectral_shift(mass, stiffness) -> float:
    """How far below zero an omega^2 counts as rounding, [(rad/s)^2]; of degrees of freedom with mass."""
    masses = mass.diagonal()
    mean = abs(stiffness.diagonal()[masses > 0.0].sum()) / masses.sum()
    return ZERO_STIFFNESS * (mean or 1.0)


def shifted_factor(mass, stiffness):
    """The factor of K + shift M, the shift of `spectral_shift`; None if some omega^2 lies below -shift."""
    return definite_factor(stiffness + spectral_shift(mass, stiffness) * mass)
