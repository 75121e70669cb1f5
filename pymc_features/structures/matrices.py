"""The constant matrices of a linear structure, dense or sparse, checked."""

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

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
    entries = matrix.data if sparse.issparse(matrix) else matrix
    if not np.isfinite(entries).all():
        raise ValueError(f"`{name}` must be finite, got NaN or infinity. Pass entries in {unit}.")
    return _symmetrised(matrix, name) if symmetric else matrix


def _numbers(value, name, unit):
    try:
        if sparse.issparse(value):
            if np.issubdtype(value.dtype, np.complexfloating):
                raise TypeError
            return sparse.csc_array(value, dtype=np.float64, copy=True)
        matrix = np.array(value)
        if matrix.dtype.kind not in "biuf":
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
