"""A basis V in which the modes of all structures of a population lie, and the matrices reduced to it.

How many eigenvalues of sparse structures lie below a number, many structures at a time.

By Sylvester's law of inertia K - mu M = L D L' has as many negative pivots as there are omega^2 below mu. The
structures share their pattern: where L has entries is found once, and the numbers are eliminated row by row
(Davis, ACM Trans. Math. Softw. 31, 587-591, 2005), one structure in each vector lane.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve_triangular

from pymc_features.algebra import assemble, massless_motions, spectral_shift
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import magnitude, where_less
from pymc_features.simulators.numbers.vectors import LANES, load, splat, store

SMALL = 1e-12  # a pivot below this share of the entries it is left of says nothing: it may be rounding


class Pattern(NamedTuple):
    """Places of the entries of a symmetric matrix and its factor L, in the order of elimination.

    Attributes
    ----------
    places : integer array (e,)
        Of the entries of a matrix in its own pattern: those above the diagonal by columns, and the n diagonal
        ones behind them.
    rows, starts : integer array (e - n,), (n + 1,)
        Rows of the former, and where a column begins.
    columns, row_starts : integer array (l,), (n + 1,)
        The columns in which each row of L has an entry, each before those that depend on it.
    factor_starts : integer array (n + 1,)
        Where the entries of a column of L begin.
    """

    places: np.ndarray
    rows: np.ndarray
    starts: np.ndarray
    columns: np.ndarray
    row_starts: np.ndarray
    factor_starts: np.ndarray


def elimination_pattern(rows, starts, order) -> Pattern:
    """The pattern of symmetric matrices given by columns, of which row i is eliminated as `order[i]`-th."""
    n = starts.size - 1
    columns = np.repeat(np.arange(n), np.diff(starts))
    new_rows, new_columns = order[rows].astype(np.int64), order[columns].astype(np.int64)
    diagonal = np.flatnonzero(new_rows == new_columns)
    diagonal = diagonal[np.argsort(new_columns[diagonal])]
    if diagonal.size < n:
        raise ValueError("a matrix must have all its diagonal entries in its pattern")
    upper = np.flatnonzero(new_rows < new_columns)
    upper = upper[np.lexsort((new_rows[upper], new_columns[upper]))]
    upper_rows = new_rows[upper]
    upper_starts = np.searchsorted(new_columns[upper], np.arange(n + 1)).astype(np.int64)
    found = factor_pattern(upper_rows, upper_starts)
    return Pattern(np.concatenate([upper, diagonal]), upper_rows, upper_starts, *found)


@jit
def factor_pattern(rows, starts):
    """Columns of the entries of each row of L, where a row begins, and where a column begins."""
    n = starts.size - 1
    parent, seen, counts = np.full(n, -1), np.full(n, -1), np.zeros(n + 1, dtype=np.int64)
    row_starts = np.zeros(n + 1, dtype=np.int64)
    for k in range(n):
        seen[k] = k
        for e in range(starts[k], starts[k + 1]):
            i = rows[e]
            while seen[i] != k:
                if parent[i] < 0:
                    parent[i] = k
                counts[i + 1] += 1
                row_starts[k + 1] += 1
                seen[i] = k
                i = parent[i]
    factor_starts, row_starts = np.cumsum(counts), np.cumsum(row_starts)
    columns, path = np.empty(row_starts[n], dtype=np.int64), np.empty(n, dtype=np.int64)
    seen[:] = -1
    for k in range(n):
        top = row_starts[k + 1]
        seen[k] = k
        for e in range(starts[k], starts[k + 1]):
            i, length = rows[e], 0
            while seen[i] != k:
                path[length] = i
                length += 1
                seen[i] = k
                i = parent[i]
            for j in range(length - 1, -1, -1):
                top -= 1
                columns[top] = path[j]
    return columns, row_starts, factor_starts


@jit
def count_below_lanes(pattern, stiffness, mass, theta, bounds):
    """Number of omega^2 below a bound, one structure in each lane; -1 where it cannot be told.

    Parameters
    ----------
    pattern : Pattern
    stiffness, mass : array (1 + p, e) or (1, e)
        Entries of K_0, K_1, ... and M_0, M_1, ..., in the order of `pattern.places`.
    theta : array (p, LANES)
    bounds : array (1, LANES)
        mu [(rad/s)^2].

    Returns
    -------
    array (LANES,)
    """
    n, above = pattern.starts.size - 1, pattern.rows.size
    zero, one = splat(0.0), splat(1.0)
    row, inverse = np.zeros((n, LANES)), np.empty((n, LANES))
    factor, at = (
        np.empty((max(pattern.columns.size, 1), LANES)),
        np.empty(pattern.columns.size, dtype=np.int64),
    )
    ends, found = pattern.factor_starts[:n].copy(), np.zeros((2, LANES))
    bound, negative, unsure = load(bounds, 0), zero, zero
    for k in range(n):
        for e in range(pattern.starts[k], pattern.starts[k + 1]):
            entry = summed(stiffness, theta, e) - bound * summed(mass, theta, e)
            store(row, pattern.rows[e], entry)
        spring, inertia = summed(stiffness, theta, above + k), bound * summed(mass, theta, above + k)
        pivot = spring - inertia
        for c in range(pattern.row_starts[k], pattern.row_starts[k + 1]):
            i = pattern.columns[c]
            entry = load(row, i)
            store(row, i, zero)
            for e in range(pattern.factor_starts[i], ends[i]):
                store(row, at[e], load(row, at[e]) - load(factor, e) * entry)
            share = entry * load(inverse, i)
            pivot = pivot - share * entry
            store(factor, ends[i], share)
            at[ends[i]] = k
            ends[i] += 1
        store(inverse, k, one / pivot)
        negative = negative + where_less(pivot, zero, one, zero)
        size = magnitude(spring) + magnitude(inertia)
        unsure = unsure + where_less(SMALL * size, magnitude(pivot), zero, one)  # NaN too
    store(found, 0, negative)
    store(found, 1, unsure)
    return np.where(found[1] > 0.0, -1.0, found[0])


@jit
def summed(stack, theta, e):
    """Entry e of A_0 + sum_i theta_i A_i."""
    total = splat(stack[0, e])
    for term in range(1, stack.shape[0]):
        share = stack[term, e]
        if share != 0.0:
            total = total + load(theta, term - 1) * share
    return total


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
