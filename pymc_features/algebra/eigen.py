"""Undamped modes of M x" + K x = 0, dense or sparse."""

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import LinearOperator, eigsh

from pymc_features.algebra.affine import to_dense
from pymc_features.algebra.factorisation import count_below, shifted_factor, spectral_shift
from pymc_features.algebra.massless import MAX_DENSE, Massless, condense, massless_motions

ROUNDING = 1e-15  # a sum this small beside the sum of its absolute terms is taken as zero
NEGATIVE = 1e-11  # beyond this share of its absolute terms a negative sum is no rounding


def natural_modes(mass, stiffness, n_modes: int, factor=None, massless: Massless | None = None):
    """Lowest modes K phi = omega^2 M phi, mass-normalised.

    Parameters
    ----------
    mass, stiffness : array or csc_array (n, n)
        [kg] and [N/m]; admissible, see `factorisation`.
    n_modes : int
        Number of modes, 1 to the rank of M.
    factor : SuperLU, optional
        Of K + shift M, of sparse matrices; made here if it is not at hand.
    massless : Massless, optional
        The null space of M; found here if it is not at hand.

    Returns
    -------
    omega : array (n_modes,)
        [rad/s], ascending; exactly zero for rigid-body modes.
    shapes : array (n, n_modes)
        Columns, the largest entry of each positive.

    Raises
    ------
    LinAlgError, a ValueError
        If an eigenvalue is negative beyond rounding, or if there are fewer modes.

    Notes
    -----
    Dense: LAPACK, O(n^3), after static condensation of what has no mass. Sparse: implicitly restarted Lanczos
    on (K + shift M)^-1 M (ARPACK), whose shift lies below all eigenvalues, so that rigid-body modes do no
    harm, and in whose range are no motions without mass. Lanczos may miss a copy of a repeated frequency; the
    inertia of K - omega^2 M says how many there are, and the search is widened until all are found. The
    eigenvalues are replaced by the Rayleigh quotients of the vectors, whose error is the square of theirs:
    twenty frequencies of 2000 are right to 1e-11 (tests/simulators/test_linear.py).
    """
    massless = massless or massless_motions(mass)
    if massless is None or n_modes > massless.rank:
        got = "a matrix with a negative eigenvalue" if massless is None else f"one of rank {massless.rank}"
        raise np.linalg.LinAlgError(f"`mass` must be semi-definite, of rank {n_modes} at least, got {got}.")
    if sparse.issparse(stiffness) and 2 * n_modes < massless.rank:
        shapes = _lanczos(mass, stiffness, n_modes, factor, massless)
    else:
        if sparse.issparse(stiffness) and massless.rank > MAX_DENSE:
            raise ValueError(
                f"`n_modes` must be below half of the {massless.rank} degrees of freedom of a sparse "
                f"structure of this size, got {n_modes}. Keep the modes below the sampling rate."
            )
        shapes = _condensed(mass, stiffness, n_modes, massless)
    inertia = (shapes * (mass @ shapes)).sum(axis=0)
    values = (shapes * (stiffness @ shapes)).sum(axis=0) / inertia
    terms = (abs(shapes) * (abs(stiffness) @ abs(shapes))).sum(axis=0) / inertia
    if (values < -NEGATIVE * terms).any():
        raise np.linalg.LinAlgError(
            f"`stiffness` must have no negative eigenvalue, got omega^2 = {values.min():.4g} (rad/s)^2. "
            "Check the signs of the elements; rigid-body modes (omega = 0) are welcome."
        )
    values = np.where(values < ROUNDING * terms, 0.0, values)
    order = np.argsort(values, kind="stable")
    values, shapes = values[order], (shapes / np.sqrt(inertia))[:, order]
    peaks = np.take_along_axis(shapes, abs(shapes).argmax(axis=0)[None], axis=0)
    return np.sqrt(values), shapes * np.where(peaks < 0.0, -1.0, 1.0)


def _condensed(mass, stiffness, n_modes, massless):
    """The vectors of the lowest eigenvalues, by dense matrices."""
    static = None
    if massless.dofs.size:
        static, mass, stiffness = condense(mass, stiffness, massless)
    some = None if n_modes == massless.rank else [0, n_modes - 1]  # all together are found faster
    _, shapes = eigh(to_dense(stiffness), to_dense(mass), subset_by_index=some)
    return shapes if static is None else static @ shapes


def _lanczos(mass, stiffness, n_modes, factor, massless):
    """The vectors of the lowest eigenvalues, none missing."""
    n, rank = stiffness.shape[0], massless.rank
    shift = spectral_shift(mass, stiffness)
    if factor is None:
        factor = shifted_factor(mass, stiffness)
    inverse = LinearOperator((n, n), matvec=factor.solve, dtype=np.float64)
    start = np.random.default_rng(0).standard_normal(n)
    for wanted in (n_modes, 2 * n_modes + 4, 4 * n_modes + 12, 8 * n_modes + 28):
        if wanted >= rank:
            break
        basis = min(rank, max(2 * wanted + 1, 20))  # there are no more directions than ranks
        values, shapes = eigsh(stiffness, wanted, mass, sigma=-shift, OPinv=inverse, v0=start, ncv=basis)
        order = np.argsort(values)[:n_modes]
        values, shapes = values[order], shapes[:, order]
        bound = values[-1] - 1e-6 * (abs(values[-1]) + shift)
        below = count_below(mass, stiffness, bound)
        if below is None or below <= np.sum(values < bound):
            return shapes
    if rank > MAX_DENSE:
        raise RuntimeError(
            f"{below} modes lie below the {n_modes} found by Lanczos iteration, which misses some. "
            "Ask for another `n_modes`, or pass dense matrices."
        )
    return _condensed(mass, stiffness, n_modes, massless)
