"""A basis V in which the modes of all structures of a population lie, and the matrices reduced to it."""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve_triangular

from pymc_features.algebra import assemble, massless_motions, spectral_shift
from pymc_features.simulators.reduced.inertia import Pattern, elimination_pattern

NEW = 5e-10  # share of a shape outside the basis from which it joins, in the norm of the energy
ROUNDING = 1e-13  # squares below this times the largest of some vectors are not told from rounding
LAST_BITS = 2e-15  # relative errors of the entries of a shape that are not taken for something new
PROBES = 24  # random vectors by which residuals are measured: off by three once in 5e7 times
DIRECTIONS = 2
FEEBLE = 1e-3  # change of omega^2 against that of entries of K or M, below which the latter counts


class Terms(NamedTuple):
    """What does not change with the basis: the matrices of a structure, and the metric of its vectors.

    Attributes
    ----------
    given : LinearParameters
        Of the arrays, see `linear.arguments`.
    stiffness, mass, damping : list of csc_array (n, n)
        A_0, A_1, ...
    energy : csc_array (n, n)
        K + shift M at one point.
    metric : csc_array (n, n)
        V' metric V = 1: M where it is constant and definite, otherwise the energy.
    is_inertia : bool
        Whether the metric is M.
    shift : float
        [(rad/s)^2]; K + shift M is definite where there is a structure.
    probes : array (n, PROBES)
        Columns Z with the covariance (K + shift M)^-1 at that point.
    pattern : Pattern
    spring_entries, mass_entries : array (1 + p, e) or (1, e)
        Entries in the order of the pattern.
    directions : array (DIRECTIONS, p)
        Random changes of theta, each of which moves some omega^2 by about as much as itself.
    """

    given: NamedTuple
    stiffness: list
    mass: list
    damping: list
    energy: sparse.csc_array
    metric: sparse.csc_array
    is_inertia: bool
    shift: float
    probes: np.ndarray
    pattern: Pattern
    spring_entries: np.ndarray
    mass_entries: np.ndarray
    directions: np.ndarray


def new_terms(given, matrices, modes) -> Terms:
    """`Terms` of structures, by one of them: its M and K, and its factor of K + shift M, omega and shapes."""
    none, layout = np.zeros(0), (given.rows, given.starts, given.n_dof)
    stiffness, mass, damping = (
        [assemble(row[None], none, *layout) for row in stack]
        for stack in (given.stiffness, given.mass, given.damping)
    )
    factor, *pairs = modes
    shift = spectral_shift(*matrices)
    is_inertia = len(mass) == 1 and massless_motions(mass[0]).rank == given.n_dof
    energy = matrices[1] + shift * matrices[0]
    pattern = elimination_pattern(given.rows, given.starts, factor.perm_c)
    spring_entries, mass_entries = (
        np.ascontiguousarray(stack[:, pattern.places]) for stack in (given.stiffness, given.mass)
    )
    return Terms(
        given,
        stiffness,
        mass,
        damping,
        energy,
        metric=mass[0] if is_inertia else energy,
        is_inertia=is_inertia,
        shift=shift,
        probes=energy_probes(factor),
        pattern=pattern,
        spring_entries=spring_entries,
        mass_entries=mass_entries,
        directions=random_directions((stiffness, mass), matrices, pairs),
    )


def random_directions(terms, matrices, modes):
    """Random changes of theta, in units in which each moves some omega^2 by about as much as itself.

    `terms` are K_0, K_1, ... and M_0, M_1, ...; what hardly moves a mode is measured by its entries.
    """
    (stiffness, mass), (omega, shapes) = terms, modes
    values, moved = omega**2, np.zeros(max(len(stiffness), len(mass)) - 1)
    for i in range(moved.size):
        slopes, share = np.zeros(values.size), 0.0
        for stack, whole, factor in ((stiffness, matrices[1], 1.0), (mass, matrices[0], -values)):
            if len(stack) > 1:
                slopes += factor * (shapes * (stack[1 + i] @ shapes)).sum(axis=0)
                own, all_of_it = abs(stack[1 + i].diagonal()), whole.diagonal()
                share = max(share, (own[all_of_it > 0.0] / all_of_it[all_of_it > 0.0]).max())
        moved[i] = max((abs(slopes) / values).max(), FEEBLE * share) or 1.0
    return np.random.default_rng(0).standard_normal((DIRECTIONS, moved.size)) / moved


def energy_probes(factor) -> np.ndarray:
    """Random vectors whose covariance is the inverse of a definite matrix F = L D L', by its `SuperLU`.

    The mean of (z' x)^2 over such vectors z is x' F^-1 x, the square of x in the norm of the energy.
    """
    roots = np.sqrt(factor.U.diagonal())
    normal = np.random.default_rng(0).standard_normal((roots.size, PROBES))
    upper = sparse.csr_array(factor.L.T)
    solved = spsolve_triangular(upper, normal / roots[:, None], lower=False, unit_diagonal=True)
    return solved[factor.perm_c]


class Basis(NamedTuple):
    """Columns V and what is reduced to them; never changed, `joined` makes another.

    Attributes
    ----------
    columns : array (n, r)
        V.
    stiffness, mass, damping : array (1 + p, r, r), or fewer
        V' A_i V, in the order of `LinearParameters`.
    spring_probes, mass_probes : array (1 + p or 1, PROBES, r)
        Z' A_i V.
    influence : array (r, d)
        Coordinates of the influence, which lies in the basis.
    """

    columns: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray
    damping: np.ndarray
    spring_probes: np.ndarray
    mass_probes: np.ndarray
    influence: np.ndarray

    @property
    def size(self) -> int:
        """Number of columns r."""
        return self.columns.shape[1]

    def reduced(self, given):
        """`LinearParameters` of a structure, or of a population, in the basis: dense."""
        none = np.zeros(0, dtype=np.int64)
        return given._replace(
            mass=self.mass.reshape(len(self.mass), -1),
            damping=self.damping.reshape(len(self.damping), self.size**2),
            stiffness=self.stiffness.reshape(len(self.stiffness), -1),
            rows=none,
            starts=none,
            influence=self.influence,
            forces=self.columns.T @ given.forces,
        )


def new_basis(terms: Terms) -> Basis:
    """The basis of the influence alone."""
    given, n = terms.given, terms.given.n_dof
    empty = [np.zeros((len(a), 0, 0)) for a in (terms.stiffness, terms.mass, terms.damping)]
    probes = [np.zeros((len(a), PROBES, 0)) for a in (terms.stiffness, terms.mass)]
    bare = Basis(np.zeros((n, 0)), *empty, *probes, np.zeros((0, given.influence.shape[1])))
    return joined(terms, bare, given.influence[:, given.influence.any(axis=0)])


def joined(terms: Terms, basis: Basis, shapes) -> Basis:
    """The basis with what is new in some shapes (n, k)."""
    new = new_columns(terms, basis.columns, shapes)
    if not new.shape[1]:
        return basis
    columns = np.hstack([basis.columns, new])
    grown = (
        grow(basis.stiffness, terms.stiffness, basis.columns, new),
        grow(basis.mass, terms.mass, basis.columns, new),
        grow(basis.damping, terms.damping, basis.columns, new, symmetric=False),
    )
    probes = [
        np.concatenate([old, [terms.probes.T @ (a @ new) for a in matrices]], axis=2)
        for old, matrices in ((basis.spring_probes, terms.stiffness), (basis.mass_probes, terms.mass))
    ]
    influence = columns.T @ (terms.metric @ terms.given.influence)
    return Basis(columns, *grown, *probes, influence)


def new_columns(terms, columns, shapes):
    """Orthonormal columns for what of some shapes lies outside of others.

    It is measured by its energy, as residuals are: a small part of stiff motions has much of it.
    """
    rest = shapes / np.sqrt((shapes * (terms.energy @ shapes)).sum(axis=0))
    rounding = LAST_BITS**2 * (terms.energy.diagonal() @ rest**2)
    least = max([NEW**2, *rounding])
    found = np.zeros((len(shapes), 0))
    while found.shape[1] < shapes.shape[1]:
        whole = np.hstack([columns, found])
        rest = outside(terms, whole, outside(terms, whole, rest))
        squares, turn = np.linalg.eigh(rest.T @ (terms.energy @ rest))
        kept = squares > max(least, ROUNDING * squares[-1])  # the others drown in rounding, this time
        if not kept.any():
            break
        new = rest @ (turn[:, kept] / np.sqrt(squares[kept]))
        for _ in range(2):  # what is left of small differences is orthogonal only now
            new = outside(terms, whole, new)
            factor = np.linalg.cholesky(new.T @ (terms.metric @ new))
            new = np.linalg.solve(factor, new.T).T
        found = np.hstack([found, new])
    return np.ascontiguousarray(found)


def outside(terms, columns, vectors):
    """Vectors less their part in the span of columns."""
    return vectors - columns @ (columns.T @ (terms.metric @ vectors))


def grow(stack, matrices, columns, new, *, symmetric=True):
    """V' A_i V (terms, r, r) of more columns."""
    old, size = stack.shape[-1], stack.shape[-1] + new.shape[1]
    grown = np.empty((len(stack), size, size))
    for reduced, matrix, before in zip(grown, matrices, stack, strict=True):
        moved = matrix @ new
        reduced[:old, :old] = before
        reduced[:old, old:] = columns.T @ moved
        reduced[old:, old:] = new.T @ moved
        reduced[old:, :old] = reduced[:old, old:].T if symmetric else (matrix.T @ new).T @ columns
    return grown
