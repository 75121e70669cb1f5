"""The constant matrices of a linear structure, dense or sparse, checked one by one and together."""

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.linalg import eigh

from pymc_features._checks import as_array, message
from pymc_features.algebra import is_definite, shifted_factor, spectral_shift

type MatrixLike = ArrayLike | sparse.sparray | sparse.spmatrix

SYMMETRY = 1e-10  # largest difference between A and A' over the largest entry that counts as rounding


def as_matrix(value, name: str, unit: str, *, n: int | None = None, symmetric: bool = True, thin=False):
    """Return a square matrix of numbers as a float64 array or `csc_array` of its own, checked.

    Parameters
    ----------
    value : array_like (n, n), sparse matrix (n, n) or array_like (n,)
        A vector stands for a diagonal matrix.
    name, unit : str
        For messages.
    n : int, optional
        Number of rows it must have.
    thin : bool
        Whether a vector becomes a sparse diagonal matrix.
    symmetric : bool
        Whether it must be symmetric; what is so up to rounding is made so exactly.
    """
    matrix = _numbers(value, name, unit)
    if matrix.ndim == 1 and matrix.size:
        matrix = sparse.csc_array(sparse.diags_array(matrix)) if thin else np.diag(matrix)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.shape[0] == 0:
        raise ValueError(
            f"`{name}` must be a square matrix, got shape {matrix.shape}. "
            "Give one row and one column for each degree of freedom."
        )
    if n not in (None, matrix.shape[0]):
        raise ValueError(
            f"`{name}` must have shape ({n}, {n}) to match `stiffness`, got {matrix.shape}. "
            "Give one row and one column for each degree of freedom."
        )
    if not np.isfinite(matrix.data if sparse.issparse(matrix) else matrix).all():
        raise ValueError(message(name, "finite", "NaN or infinity", f"Pass entries in {unit}."))
    return _symmetrised(matrix, name) if symmetric else matrix


def _numbers(value, name, unit):
    try:
        if sparse.issparse(value):
            if np.issubdtype(value.dtype, np.complexfloating):
                raise TypeError
            return sparse.csc_array(value, dtype=np.float64, copy=True)
        matrix = as_array(value)
        if matrix.dtype.kind not in "iuf":
            raise TypeError
    except (TypeError, ValueError):
        raise TypeError(
            f"`{name}` must be a matrix of real numbers, got {type(value).__name__}. "
            f"Pass an array or a SciPy sparse matrix in {unit}; what is random goes into the `theta` of an "
            "AffineStructure."
        ) from None
    return matrix.astype(np.float64)


def _symmetrised(matrix, name):
    difference = abs(matrix - matrix.T)
    if difference.max() > SYMMETRY * abs(matrix).max():
        flat = difference.toarray() if sparse.issparse(difference) else difference
        i, j = np.unravel_index(flat.argmax(), flat.shape)
        i, j = sorted((int(i), int(j)))
        raise ValueError(
            f"`{name}` must be symmetric, got {matrix[i, j]:g} in row {i}, column {j} and "
            f"{matrix[j, i]:g} in row {j}, column {i}. Where only one triangle is stored, add its transpose."
        )
    half = 0.5 * (matrix + matrix.T)
    return sparse.csc_array(half) if sparse.issparse(half) else half


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
    factor = shifted_factor(mass, stiffness)
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
