"""Undamped modes of M x" + K x = 0, dense or sparse."""

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import LinearOperator, eigsh

from pymc_features.structures.factorisation import count_below, spectral_shift
from pymc_features.structures.matrices import to_dense

MAX_DENSE = 3000  # a sparse structure of more degrees of freedom is never solved as a dense one


def natural_modes(mass, stiffness, n_modes: int, factor=None):
    """Lowest modes K phi = omega^2 M phi, mass-normalised.

    Parameters
    ----------
    mass, stiffness : array or csc_array (n, n)
        [kg] and [N/m]; admissible, see `factorisation`.
    n_modes : int
        Number of modes, 1 to n.
    factor : SuperLU, optional
        Of K + shift M, of sparse matrices.

    Returns
    -------
    omega : array (n_modes,)
        [rad/s], ascending; exactly zero for rigid-body modes.
    shapes : array (n, n_modes)
        Columns, the largest entry of each positive.

    Notes
    -----
    Dense: LAPACK, O(n^3). Sparse: implicitly restarted Lanczos on (K + shift M)^-1 M (ARPACK), whose shift
    lies below all eigenvalues, so that rigid-body modes do no harm. Lanczos may miss a copy of a repeated
    frequency; the inertia of K - omega^2 M says how many there are, and the search is widened until all
    are found.
    """
    if sparse.issparse(stiffness) and 2 * n_modes < stiffness.shape[0]:
        values, shapes = _lanczos(mass, stiffness, n_modes, factor)
    else:
        if sparse.issparse(stiffness) and stiffness.shape[0] > MAX_DENSE:
            raise ValueError(
                f"`n_modes` must be below half of the {stiffness.shape[0]} degrees of freedom of a sparse "
                f"structure of this size, got {n_modes}. Keep the modes below the sampling rate."
            )
        values, shapes = eigh(to_dense(stiffness), to_dense(mass), subset_by_index=[0, n_modes - 1])
    largest = (stiffness.diagonal() / mass.diagonal()).max()
    rounding = 10.0 * stiffness.shape[0] * np.finfo(float).eps * largest
    values = np.where(values < rounding, 0.0, values)
    shapes = shapes / np.sqrt((shapes * (mass @ shapes)).sum(axis=0))
    peaks = np.take_along_axis(shapes, abs(shapes).argmax(axis=0)[None], axis=0)
    return np.sqrt(values), shapes * np.where(peaks < 0.0, -1.0, 1.0)


def _lanczos(mass, stiffness, n_modes, factor):
    """The lowest eigenpairs, none missing."""
    n = stiffness.shape[0]
    shift = spectral_shift(mass, stiffness)
    inverse = LinearOperator((n, n), matvec=factor.solve, dtype=np.float64)
    start = np.random.default_rng(0).standard_normal(n)
    wanted = n_modes
    while wanted < n:
        values, shapes = eigsh(stiffness, wanted, mass, sigma=-shift, OPinv=inverse, v0=start)
        order = np.argsort(values)[:n_modes]
        values, shapes = values[order], shapes[:, order]
        bound = values[-1] - 1e-6 * (abs(values[-1]) + shift)
        below = count_below(mass, stiffness, bound)
        if below is None or below <= np.sum(values < bound):
            return values, shapes
        wanted = 2 * wanted + 4
    return eigh(to_dense(stiffness), to_dense(mass), subset_by_index=[0, n_modes - 1])
