"""Matrices without structures, dense or sparse: affine sums, factorisations, natural modes.

By Sylvester's law of inertia the pivots of A = L D L' have the signs of the eigenvalues of A. A positive
definite matrix can be eliminated along its diagonal in any order; SuperLU in symmetric mode does so, and
a pivot off the diagonal or below zero says that the matrix is not definite.

N is the null space of M, where it is singular. K phi = omega^2 M phi says N' K phi = 0: what has no mass
follows the modes statically, and there are as many modes as the rank of M, if K is positive definite on N. Of
degrees of freedom without mass that is the static condensation of Guyan (AIAA Journal 3, 380, 1965), which is
exact for them.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve, cholesky, eigh
from scipy.sparse.linalg import LinearOperator, SuperLU, eigsh, splu

ZERO_STIFFNESS = 1e-8  # |omega^2| below this times trace(K) / trace(M) counts as rounding
MASSLESS = 1e-11  # a pivot of M below this share of its diagonal entry is rounding
INDEFINITE = 1e-10  # what such pivots leave of M, on the scale of its diagonal, is rounding up to here
UNHELD = 1e-13  # a pivot of K on N below this share of its diagonal entry is rounding
MAX_DENSE = 3000  # larger sparse matrices are never made dense
ROUNDING = 1e-15  # a sum this small beside the sum of its absolute terms is taken as zero
NEGATIVE = 1e-11  # beyond this share of its absolute terms a negative sum is no rounding


# ---- affine sums: their entries stacked once, the sums formed without assembly ----


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


# ---- factorisations ----


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


# ---- motions without mass ----


class Massless(NamedTuple):
    """The null space of a positive semi-definite M.

    Attributes
    ----------
    dofs : integer array (k,)
        Degrees of freedom without mass, or, where several move one mass, all but those that stand for it.
    motions : array or csc_array (n, k)
        N, M N = 0; the identity in the rows `dofs`.
    """

    dofs: np.ndarray
    motions: np.ndarray | sparse.csc_array

    @property
    def rank(self) -> int:
        """Rank of M, the number of modes."""
        return self.motions.shape[0] - self.dofs.size

    @property
    def others(self) -> np.ndarray:
        """The other degrees of freedom, integer array (rank,)."""
        return np.setdiff1d(np.arange(self.motions.shape[0]), self.dofs)

    def stiffness(self, stiffness):
        """N' K N, array or sparse (k, k)."""
        return self.motions.T @ (stiffness @ self.motions)

    def are_held(self, stiffness) -> bool:
        """Whether K is positive definite on N."""
        return not self.dofs.size or definite_factor(self.stiffness(stiffness), UNHELD) is not None


def massless_motions(mass) -> Massless | None:
    """Null space of M, array or sparse (n, n); None if M has a negative eigenvalue.

    Notes
    -----
    One factorisation of a definite M. Else rows of zeros are left aside, and of the others a small pivot of M
    with its diagonal raised by 1e-14 shows a row that depends on those before it, whatever the units.
    """
    diagonal, (empty, own) = mass.diagonal(), rows_of_zeros([mass])
    is_definite = (diagonal > 0.0).all() and definite_factor(mass, MASSLESS) is not None
    if is_definite or not own.size:
        return null_space(mass, empty, own)
    inner, scale = part(mass, own, own), diagonal[own]
    nudge = sparse.diags_array(1e-14 * scale) if sparse.issparse(mass) else np.diag(1e-14 * scale)
    factor = definite_factor(inner + nudge)
    if factor is None:
        return None
    small = pivots(factor) <= MASSLESS * scale
    own, dependent, root = own[~small], own[small], np.sqrt(scale[small])
    if not dependent.size:
        return null_space(mass, empty, own)
    factor, mixed = definite_factor(part(mass, own, own), MASSLESS), to_dense(part(mass, own, dependent))
    if factor is None:
        return None
    share = solve(factor, mixed)  # of the masses of `own`
    left = to_dense(part(mass, dependent, dependent)) - mixed.T @ share
    if (abs(left) > INDEFINITE * root[:, None] * root).any():
        return None
    return null_space(mass, np.concatenate([empty, dependent]), own, share)


def null_space(mass, dofs, own, share=None) -> Massless:
    """N with the identity at `dofs` (k,); its last columns have minus a `share` (r, j) at `own`, if any."""
    moved = sparse.coo_array((own.size, 0) if share is None else share)
    rows = np.concatenate([dofs, own[moved.coords[0]]])
    columns = np.concatenate([np.arange(dofs.size), dofs.size - moved.shape[1] + moved.coords[1]])
    entries = np.concatenate([np.ones(dofs.size), -moved.data])
    motions = sparse.csc_array((entries, (rows, columns)), shape=(mass.shape[0], dofs.size))
    return Massless(dofs, motions if sparse.issparse(mass) else motions.toarray())


def rows_of_zeros(masses) -> tuple[np.ndarray, np.ndarray]:
    """Rows (k,) that are zero in all of some matrices, and the others."""
    touched = sum(np.asarray(abs(mass).sum(axis=1)).ravel() for mass in masses) != 0.0  # NaN too
    return np.flatnonzero(~touched), np.flatnonzero(touched)


def always_massless(masses) -> Massless:
    """Motions without mass that matrices M_0, M_1, ... share: what any M_0 + sum_i theta_i M_i has of them.

    Rows of zeros, and all others where each matrix is semi-definite.
    """
    signed = (mass if mass.diagonal().sum() >= 0.0 else -mass for mass in masses)
    found = massless_motions(sum(signed))
    if found is not None and all(is_rest(mass, found.motions) for mass in masses):
        return found
    empty, own = rows_of_zeros(masses)
    return null_space(masses[0], empty, own)


def is_rest(mass, motions) -> bool:
    """Whether motions (n, k) move none of a mass."""
    if motions.shape[1] == 0:
        return True
    return (abs(mass @ motions) - INDEFINITE * (abs(mass) @ abs(motions))).max() <= 0.0


def condense(mass, stiffness, massless: Massless):
    """Static condensation of motions without mass.

    Returns
    -------
    shapes : array (n, r)
        S: unit displacements of the other degrees of freedom, N' K S = 0.
    mass, stiffness : array (r, r)
        S' M S and S' K S.

    Raises
    ------
    LinAlgError, a ValueError
        If K is not positive definite on N.
    """
    others, motions = massless.others, massless.motions
    factor = definite_factor(massless.stiffness(stiffness), UNHELD)
    if factor is None:
        raise np.linalg.LinAlgError(
            "`stiffness` must hold every motion without mass, got one with neither. Attach an element."
        )
    shapes = -(motions @ solve(factor, to_dense(motions.T @ stiffness[:, others])))
    shapes[others, np.arange(others.size)] += 1.0
    return shapes, to_dense(part(mass, others, others)), shapes.T @ (stiffness @ shapes)


def softest_motion(stiffness, massless: Massless) -> tuple[float, np.ndarray]:
    """The motion without mass (n,) that K holds least, on the scale of its diagonal, and x' K x of it."""
    held = massless.stiffness(stiffness)
    diagonal = abs(held.diagonal())
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    scaling = sparse.diags_array(scale)
    scaled = scaling @ held @ scaling
    if massless.dofs.size > MAX_DENSE:
        value, vectors = eigsh(scaled, 1, sigma=-1e-6)
    else:
        value, vectors = eigh(to_dense(scaled), subset_by_index=[0, 0])
    return float(value[0]), massless.motions @ (scale * vectors[:, 0])


def part(matrix, rows, columns):
    """Some rows and columns of an array or sparse matrix."""
    return matrix[rows][:, columns]


# ---- natural modes ----


def natural_modes(mass, stiffness, n_modes: int, factor=None, massless: Massless | None = None):
    """Lowest modes K phi = omega^2 M phi, mass-normalised.

    Parameters
    ----------
    mass, stiffness : array or csc_array (n, n)
        [kg] and [N/m]; admissible.
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
