"""Motions without mass: the null space N of M, where it is singular, and the structure condensed to the rest.

K phi = omega^2 M phi says N' K phi = 0: what has no mass follows the modes statically, and there are as many
modes as the rank of M, if K is positive definite on N. Of degrees of freedom without mass that is the static
condensation of Guyan (AIAA Journal 3, 380, 1965), which is exact for them.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh

from pymc_features.algebra.affine import to_dense
from pymc_features.algebra.factorisation import definite_factor, pivots, solve

MASSLESS = 1e-11  # a pivot of M below this share of its diagonal entry is rounding
INDEFINITE = 1e-10  # what such pivots leave of M, on the scale of its diagonal, is rounding up to here
UNHELD = 1e-13  # a pivot of K on N below this share of its diagonal entry is rounding
MAX_DENSE = 3000  # larger sparse matrices are never made dense


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
    n, diagonal = mass.shape[0], mass.diagonal()
    if (diagonal > 0.0).all() and definite_factor(mass, MASSLESS) is not None:
        none = sparse.csc_array((n, 0)) if sparse.issparse(mass) else np.zeros((n, 0))
        return Massless(np.zeros(0, dtype=np.int64), none)
    empty, own = rows_of_zeros([mass])
    if not own.size:
        return null_space(mass, empty, own, np.zeros((0, 0)))
    inner, scale = part(mass, own, own), diagonal[own]
    nudge = sparse.diags_array(1e-14 * scale) if sparse.issparse(mass) else np.diag(1e-14 * scale)
    factor = definite_factor(inner + nudge)
    if factor is None:
        return None
    small = pivots(factor) <= MASSLESS * scale
    own, dependent, root = own[~small], own[small], np.sqrt(scale[small])
    if not dependent.size:
        return null_space(mass, empty, own, np.zeros((own.size, 0)))
    factor, mixed = definite_factor(part(mass, own, own), MASSLESS), to_dense(part(mass, own, dependent))
    if factor is None:
        return None
    share = solve(factor, mixed)  # of the masses of `own`
    left = to_dense(part(mass, dependent, dependent)) - mixed.T @ share
    if (abs(left) > INDEFINITE * root[:, None] * root).any():
        return None
    return null_space(mass, np.concatenate([empty, dependent]), own, share)


def null_space(mass, dofs, own, share) -> Massless:
    """N with the identity at `dofs` (k,), and in its last columns minus the `share` (r, j) at `own`."""
    columns, moved = np.arange(dofs.size), sparse.coo_array(share)
    rows = np.concatenate([dofs, own[moved.coords[0]]])
    columns = np.concatenate([columns, dofs.size - share.shape[1] + moved.coords[1]])
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
    return null_space(masses[0], empty, own[:0], np.zeros((0, 0)))


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
