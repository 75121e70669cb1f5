"""Matrices that are affine in parameters: their entries stacked once, the sums formed without assembly."""

import numpy as np
from scipy import sparse


def to_dense(matrix) -> np.ndarray:
    """The matrix as an array."""
    return matrix.toarray() if sparse.issparse(matrix) else matrix


def common_pattern(matrices) -> tuple[np.ndarray, np.ndarray]:
    """Places where any of some sparse matrices (n, n) has an entry, by columns.

    Returns
    -------
    rows : integer array (e,)
    starts : integer array (n + 1,)
        Column j has the entries starts[j] ... starts[j + 1] - 1.
    """
    n = matrices[0].shape[0]
    places = np.unique(np.concatenate([_places(a) for a in matrices]))
    columns, rows = np.divmod(places, n)
    return rows, np.searchsorted(columns, np.arange(n + 1)).astype(np.int64)


def _places(matrix):
    matrix = sparse.coo_array(matrix)
    return matrix.coords[1].astype(np.int64) * matrix.shape[0] + matrix.coords[0]


def assemble(stack, theta, rows, starts, n):
    """A(theta) = A_0 + sum_i theta_i A_i, an array or `csc_array` (n, n).

    Parameters
    ----------
    stack : array (1 + p, e) or (1, e)
        Entries of A_0, A_1, ...; only A_0 where nothing depends on theta.
    theta : array (p,)
    rows, starts : integer arrays
        From `common_pattern`; both empty for dense matrices, whose entries are in C order.
    """
    total = stack[0] + theta @ stack[1:] if stack.shape[0] > 1 else stack[0]
    if not starts.size:
        total = total.reshape(n, n)
        total.setflags(write=False)
        return total
    matrix = sparse.csc_array((total, rows, starts), shape=(n, n), copy=True)
    matrix.eliminate_zeros()  # the pattern serves other matrices too
    return matrix


class AffineMatrix:
    """A(theta) = A_0 + sum_i theta_i A_i, the constant matrices stacked once.

    Parameters
    ----------
    constant : array or csc_array (n, n)
        A_0; all matrices are kept as it is, dense or sparse.
    terms : sequence of array, csc_array or None
        A_i, None for zero.
    pattern : tuple of arrays, optional
        From `common_pattern` of these matrices and perhaps of others; of these alone by default.

    Attributes
    ----------
    stack : array (1 + p, e), or (1, e) if no term depends on theta
        A_0, A_1, ...: all n n entries, or of sparse matrices those of the pattern.
    rows, starts : integer arrays
        The pattern; empty for dense matrices.
    """

    def __init__(self, constant, terms=(), pattern=None):
        self.is_sparse = sparse.issparse(constant)
        self.shape = constant.shape
        matrices = [constant, *terms] if any(a is not None for a in terms) else [constant]
        if self.is_sparse:
            self.rows, self.starts = pattern or common_pattern([a for a in matrices if a is not None])
            columns = np.repeat(np.arange(self.shape[0]), np.diff(self.starts))
            places = columns * self.shape[0] + self.rows
            self.stack = np.zeros((len(matrices), places.size))
            for row, matrix in zip(self.stack, matrices, strict=True):
                if matrix is not None:
                    np.add.at(row, np.searchsorted(places, _places(matrix)), sparse.coo_array(matrix).data)
        else:
            self.rows = self.starts = np.zeros(0, dtype=np.int64)
            zero = np.zeros(self.shape)
            self.stack = np.stack([(zero if a is None else to_dense(a)).ravel() for a in matrices])
        for array in (self.stack, self.rows, self.starts):
            array.setflags(write=False)

    def matrices(self) -> list:
        """Return A_0, A_1, ..., or A_0 alone where nothing depends on theta."""
        none = np.zeros(0)
        return [assemble(row[None], none, self.rows, self.starts, self.shape[0]) for row in self.stack]

    def at(self, theta: np.ndarray):
        """Return A(theta), an array or `csc_array` (n, n), without assembly."""
        return assemble(self.stack, theta, self.rows, self.starts, self.shape[0])
