"""Which matrices are admissible, told by factorisations: Cholesky, and of sparse ones the pivots.

By Sylvester's law of inertia the pivots of A = L D L' have the signs of the eigenvalues of A. A positive
definite matrix can be eliminated along its diagonal in any order; SuperLU in symmetric mode does so, and
a pivot off the diagonal or below zero says that the matrix is not definite.
"""

import numpy as np
from scipy import sparse
from scipy.linalg import cholesky, eigh
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


def definite_factor(matrix):
    """The factor of a positive definite matrix (`SuperLU` if sparse); None if it is not definite."""
    if sparse.issparse(matrix):
        factor = eliminate(matrix)
        return factor if factor is not None and (factor.U.diagonal() > 0.0).all() else None
    try:
        return cholesky(matrix, lower=True, check_finite=False)
    except np.linalg.LinAlgError:
        return None


def count_below(mass, stiffness, eigenvalue: float) -> int | None:
    """Number of omega^2 of sparse matrices below a value, by inertia; None where it cannot be told."""
    factor = eliminate(stiffness - eigenvalue * mass)
    return None if factor is None else int((factor.U.diagonal() < 0.0).sum())


def spectral_shift(mass, stiffness) -> float:
    """How far below zero an omega^2 counts as rounding, [(rad/s)^2]."""
    mean = abs(stiffness.diagonal().sum()) / mass.diagonal().sum()
    return ZERO_STIFFNESS * (mean or 1.0)


def check_mass(mass) -> None:
    """Refuse a mass matrix that is not positive definite."""
    if is_definite(mass):
        return
    diagonal = mass.diagonal()
    i = int(diagonal.argmin())
    got = f"{diagonal[i]:g} kg at degree of freedom {i}" if diagonal[i] <= 0.0 else "an indefinite matrix"
    raise ValueError(
        f"`mass` must be positive definite, got {got}. Condense degrees of freedom without mass."
    )


def check_stiffness(mass, stiffness):
    """Refuse K with a negative omega^2; return the factor of K + shift M, definite if K is admissible."""
    shift = spectral_shift(mass, stiffness)
    factor = definite_factor(stiffness + shift * mass)
    if factor is None:
        got = "a negative pivot"
        if not sparse.issparse(stiffness):
            lowest = eigh(stiffness, mass, eigvals_only=True, subset_by_index=[0, 0])[0]
            got = f"omega^2 = {lowest:.4g} (rad/s)^2 as the lowest eigenvalue"
        raise ValueError(
            f"`stiffness` must have no negative eigenvalue, got {got}. "
            "Check the signs of the elements; rigid-body modes (omega = 0) are welcome."
        )
    return factor


def check_damping(mass, damping) -> None:
    """Refuse a damping matrix that feeds energy into some motion, x' C x < 0."""
    symmetric = 0.5 * (damping + damping.T)
    if not is_definite(symmetric + spectral_shift(mass, symmetric) * mass):
        raise ValueError(
            "`damping` must not feed energy into any motion, got a matrix whose symmetric part has a "
            "negative eigenvalue. Check the signs of the dashpots."
        )


def check_connected(mass, damping, stiffness) -> None:
    """Refuse a degree of freedom that nothing touches: no spring, no dashpot, no shared mass."""
    touched = abs(mass).sum(axis=1) - abs(mass.diagonal()) + abs(stiffness).sum(axis=1)
    if damping is not None:
        touched = touched + abs(damping).sum(axis=1)
    free = np.flatnonzero(np.asarray(touched).ravel() == 0.0)
    if free.size:
        raise ValueError(
            f"`stiffness` must hold every degree of freedom, got a row of zeros for {free[0]}"
            f"{' and others' if free.size > 1 else ''}. Remove the degree of freedom or attach an element; "
            "a structure may move as a whole, but not a node by itself."
        )
