"""The bases of a process, found again by the matrices they belong to.

Modes of structures in a basis, where their residuals are small and none is missing.
"""

import threading
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, eigh

from pymc_features.simulators.linear.basis import (
    Basis,
    Terms,
    count_below_lanes,
    joined,
    new_basis,
    new_terms,
)
from pymc_features.simulators.numbers.vectors import LANES

TOLERANCE = 2e-9  # of shapes, in the norm of the energy, by the probes
OF_DERIVATIVES = 1e-6  # the same, along parameters in units in which some omega^2 moves by as much as itself
FINER = TOLERANCE / OF_DERIVATIVES
MASSLESS = 1e-13  # an inverse eigenvalue below this times the largest is that of a motion without mass
BELOW = 1e-6  # how far below the highest mode kept the others are counted, as a share of omega^2


class Candidate(NamedTuple):
    """Modes of a structure in a basis, not yet known to be complete.

    Attributes
    ----------
    values : array (> m,) or (r,)
        omega^2.
    vectors : array (r, > m)
    """

    values: np.ndarray
    vectors: np.ndarray


def candidates(terms: Terms, basis: Basis, theta, m, left_out) -> tuple:
    """Modes in the basis of those structures of which the residuals are small, and how large all are.

    `theta` (p, t); a dictionary by its rows, and an array (p,), infinite where no modes were found at all.
    """
    stacks = basis.stiffness, basis.mass, basis.spring_probes, basis.mass_probes
    found, errors = {}, np.full(len(theta), np.inf)
    for i in np.flatnonzero(np.isfinite(theta).all(axis=1)):
        weights = np.append(1.0, theta[i])
        # one by one: in a product of all, the last bits would depend on how many there are
        matrices = [np.tensordot(weights[: len(stack)], stack, 1) for stack in stacks]
        try:
            candidate, errors[i] = solve_reduced(terms, matrices, m, left_out)
        except LinAlgError:
            continue
        if errors[i] <= TOLERANCE and left_out:
            errors[i] = max(errors[i], derivative_error(terms, basis, matrices, m, candidate) * FINER)
        if errors[i] <= TOLERANCE:
            found[i] = candidate
    return found, errors


def solve_reduced(terms, matrices, m, left_out) -> tuple:
    """Modes of V' K V and V' M V, and the largest residual of the lowest m."""
    stiffness, mass, springs, masses = matrices
    own_mass = None if terms.is_inertia else mass
    values, vectors = lowest(stiffness, own_mass, terms.shift, None if left_out else m + 1)
    kept = vectors[:, :m]
    inertia = 1.0 if terms.is_inertia else (kept * (mass @ kept)).sum(axis=0)
    values[:m] = (kept * (stiffness @ kept)).sum(axis=0) / inertia
    if not values[0] > terms.shift:  # rigid bodies have no energy to measure errors by
        return None, np.inf
    residuals = springs @ kept - (masses @ kept) * values[:m]
    return Candidate(values, vectors), size(residuals, values[:m])


def lowest(stiffness, mass, shift, count):
    """Lowest modes of K y = lambda M y, or of all rows where `count` is None.

    Parameters
    ----------
    stiffness, mass : array (r, r)
        K + shift M is positive definite, else a LinAlgError says so. `mass` None stands for the identity.
    shift : float
    count : int or None

    Returns
    -------
    values : array (count,)
        Ascending; infinite for motions without mass.
    vectors : array (r, count)
        y' M y = 1, and y' K y = 1 for motions without mass.
    """
    n = len(stiffness)
    count = n if count is None else min(count, n)
    if mass is None:
        return eigh(stiffness, subset_by_index=[0, count - 1], check_finite=False)
    highest = [n - count, n - 1]
    inverses, vectors = eigh(mass, stiffness + shift * mass, subset_by_index=highest, check_finite=False)
    inverses, vectors = inverses[::-1], vectors[:, ::-1]
    has_mass = inverses > MASSLESS * inverses[0]
    values = np.full(count, np.inf)
    values[has_mass] = 1.0 / inverses[has_mass] - shift
    return values, vectors / np.sqrt(np.where(has_mass, inverses, 1.0))


def size(residuals, values) -> float:
    """The largest norm of residuals (PROBES, m) that the probes have seen, as a share of a mode's energy."""
    largest = np.sqrt((residuals**2).mean(axis=0) / values).max()
    return largest if np.isfinite(largest) else np.inf


def derivative_error(terms, basis, matrices, m, found) -> float:
    """How far derivatives of the kept modes lie outside the basis, by residuals along random directions.

    They solve (K - lambda M) dphi = -(dK - lambda dM) phi, in the basis by the other modes in it; what the
    kept ones have of it lies there in any case.
    """
    _, mass, springs, masses = matrices
    kept, others = found.vectors[:, :m], found.vectors[:, m:]
    values, above = found.values[:m], found.values[m:, None]
    gaps, largest = np.where(np.isinf(above), 1.0, above - values), 0.0
    for direction in terms.directions:
        loads = change(direction, basis.stiffness) @ kept
        residuals = change(direction, basis.spring_probes) @ kept
        if len(basis.mass) > 1:
            loads = loads - change(direction, basis.mass) @ kept * values
            residuals = residuals - change(direction, basis.mass_probes) @ kept * values
        moved = others @ (others.T @ loads / -gaps)
        residuals += springs @ moved - masses @ moved * values - masses @ kept @ (kept.T @ loads)
        largest = max(largest, size(residuals, values))
    return largest


def change(direction, stack):
    """sum_i d_i A_i, zero where nothing depends on theta."""
    return np.tensordot(direction, stack[1:], 1) if len(stack) > 1 else np.zeros(stack.shape[1:])


def complete(terms: Terms, theta, m, found) -> list:
    """Which candidates are all there is: M definite, and no other omega^2 below the highest one kept."""
    if not found:
        return []
    places = list(found)
    lanes, bounds = np.zeros((theta.shape[1], LANES)), np.zeros((1, LANES))
    lanes[:, : len(places)] = theta[places].T
    bounds[0, : len(places)] = [found[i].values[m - 1] * (1.0 - BELOW) for i in places]
    springs, masses = terms.spring_entries, terms.mass_entries
    below = count_below_lanes(terms.pattern, springs, masses, lanes, bounds)
    good = [below[k] == np.sum(found[i].values[:m] < bounds[0, k]) for k, i in enumerate(places)]
    if len(masses) > 1:
        good &= have_mass(terms, lanes)[: len(places)]
    return [i for k, i in enumerate(places) if good[k]]


def have_mass(terms, lanes) -> np.ndarray:
    """In which lanes M is known to be definite, or diagonal and positive but where no structure has mass."""
    masses, above = terms.mass_entries, terms.pattern.rows.size
    if masses[:, :above].any():
        return count_below_lanes(terms.pattern, masses, masses, lanes, np.zeros((1, LANES))) == 0.0
    diagonal = masses[0, above:, None] + masses[1:, above:].T @ lanes
    return ((diagonal > 0.0) | ~masses[:, above:].any(axis=0)[:, None]).all(axis=0)


def with_signs(columns, vectors, m):
    """The vectors (r, > m), the lowest m so that the largest entry of each shape (n,) is positive."""
    shapes = columns @ vectors[:, :m]
    peaks = np.take_along_axis(shapes, abs(shapes).argmax(axis=0)[None], axis=0)
    return np.hstack([vectors[:, :m] * np.where(peaks < 0.0, -1.0, 1.0), vectors[:, m:]])


MOST_STRUCTURES = 4  # of which bases are kept; the one not asked for longest goes first
MOST_COLUMNS = 400
LARGE = 8  # degrees of freedom for each mode kept from which a basis is worth while
FEWEST = 8  # structures asked for before a basis is begun
# structures that bring nothing new although they were not found: they are the same, or rounding hides all
FRUITLESS = 8
GUARDS = 3  # one mode more for so many is learnt, since the highest ones change places with those above
ARRAYS = "stiffness", "mass", "damping", "influence", "rows", "starts"


class Search:
    """How the search in a basis goes, for modes or for modes with what their derivatives need.

    Attributes
    ----------
    tried, found, fruitless : int
        How many structures were tried in the basis there is, how many were found in it, and how many of those
        that were not brought nothing new to it.
    is_given_up : bool
        Whether no basis of some hundred columns holds most of them, or rounding hides that one does.
    """

    def __init__(self):
        self.is_given_up = False
        self.begin()

    def begin(self):
        """Begin in another basis."""
        self.tried = self.found = self.fruitless = 0

    def begin_again_if_in_vain(self):
        """The basis has grown: it may hold now what it did not."""
        if self.fruitless >= FRUITLESS:
            self.is_given_up = False
            self.begin()


class Known:
    """What is known of structures that share their matrices.

    Attributes
    ----------
    asked, solved : int
        How many structures have been asked for, and how many have been learnt.
    searches : dict
        A `Search` for modes alone (False), and one for modes with those that are left out (True).
    is_fixed : bool
        Whether nothing more is learnt: what is found then depends on a structure alone, not on those before.
    """

    def __init__(self, given, n_modes):
        self.given = given._replace(**{name: getattr(given, name).copy() for name in ARRAYS})
        self.n_modes, self.asked, self.solved, self.is_fixed = n_modes, 0, 0, False
        self.most = min(MOST_COLUMNS, given.n_dof // 2)
        self.terms, self.basis = None, None
        self.searches = {False: Search(), True: Search()}

    def fits(self, given, n_modes) -> bool:
        """Whether this was found of these structures."""
        pairs = [(getattr(self.given, name), getattr(given, name)) for name in ARRAYS]
        return self.n_modes == n_modes and all(np.array_equal(x, y) for x, y in pairs)

    @property
    def is_begun(self) -> bool:
        """Whether there are more columns than modes."""
        return self.basis is not None and self.basis.size > self.n_modes + 1

    @property
    def found(self) -> int:
        """How many structures were found in the basis there is."""
        return sum(search.found for search in self.searches.values())

    @property
    def is_given_up(self) -> bool:
        """Whether every search that there was is given up."""
        searches = [search for search in self.searches.values() if search.tried or search.is_given_up]
        return bool(searches) and all(search.is_given_up for search in searches)

    @property
    def n_learnt(self) -> int:
        """Number of modes that are learnt of each structure solved in full."""
        return self.n_modes + self.n_modes // GUARDS

    def modes(self, theta, *, left_out=False, signed=False) -> tuple:
        """The basis, and omega (> m,) and vectors (r, > m) of those of up to `LANES` structures found in it.

        Last comes how large the residuals of all are (p,), infinite where there are none.

        Parameters
        ----------
        theta : array (p, t)
        left_out : bool
            Whether all modes in the basis are wanted, for derivatives, which must lie in it too.
        signed : bool
            Whether shapes must be positive at their largest entry.
        """
        if not self.is_begun:
            return None, {}, np.full(len(theta), np.inf)
        m, basis = self.n_modes, self.basis
        some, errors = candidates(self.terms, basis, theta, m, left_out)
        places = complete(self.terms, theta, m, some)
        search = self.searches[left_out]
        search.tried, search.found = search.tried + len(theta), search.found + len(places)
        result = {}
        for i in places:
            values, vectors = some[i]
            vectors = with_signs(basis.columns, vectors, m) if signed else vectors
            result[i] = np.sqrt(np.maximum(values, 0.0)), vectors
        return basis, result, errors

    def learn(self, matrices, modes, *, left_out=False):
        """Let the modes of a structure that was not found join.

        Parameters
        ----------
        matrices, modes : tuple
            M and K; the factor of K + shift M, omega and shapes.
        left_out : bool
            As it was in `modes`.
        """
        _, omega, shapes = modes
        search = self.searches[left_out]
        is_rigid = omega[0] <= 0.0  # then there is no energy to measure errors by
        if is_rigid or search.is_given_up or self.is_fixed:
            return
        if self.terms is None:
            self.terms = new_terms(self.given, matrices, modes)
            self.basis = new_basis(self.terms)
        grown = joined(self.terms, self.basis, shapes)
        if grown.size > self.basis.size:
            self.searches[not left_out].begin_again_if_in_vain()
        else:
            search.fruitless += 1
        is_full = grown.size > self.most
        if is_full or search.fruitless >= FRUITLESS:
            search.is_given_up = 2 * search.found < search.tried
        if is_full:  # begin anew, where the structures are now
            grown = joined(self.terms, new_basis(self.terms), shapes)
            for each in self.searches.values():
                each.begin()
        self.basis, self.solved = grown, self.solved + 1


class AllKnown(threading.local):
    """The last few of a thread; or those that were made for a function, and are fixed.

    Attributes
    ----------
    entries : list of Known
        The one asked for last comes first.
    bases : tuple of Known, or None
        Nothing else is known, where it is not None.
    """

    def __init__(self):
        self.entries, self.bases = [], None

    def of(self, given, n_modes, count, *, left_out=False) -> Known | None:
        """What is known of structures, `count` of which are asked for; None where it is not worth while."""
        if given.is_dense or given.has_constant_modes or given.n_dof < LARGE * n_modes:
            return None
        if self.bases is not None:
            known = (e for e in self.bases if e.fits(given, n_modes) and not e.searches[left_out].is_given_up)
            return next(known, None)
        for entry in self.entries:
            if entry.fits(given, n_modes):
                self.entries.remove(entry)
                break
        else:
            entry = Known(given, n_modes)
        self.entries = [entry, *self.entries[: MOST_STRUCTURES - 1]]
        entry.asked += count
        return entry if entry.asked >= FEWEST and not entry.searches[left_out].is_given_up else None

    def forget(self):
        """Drop all, so that what follows does not depend on what was before."""
        self.entries = []

    @contextmanager
    def learning(self):
        """Begin with nothing, and forget at the end what was learnt."""
        before = self.entries, self.bases
        self.entries, self.bases = [], None
        try:
            yield
        finally:
            self.entries, self.bases = before

    def fix(self) -> tuple:
        """What has been learnt, from now on fixed."""
        for entry in self.entries:
            entry.is_fixed = True
        return tuple(self.entries)

    @contextmanager
    def only(self, bases):
        """Know these and nothing else; None changes nothing."""
        before = self.bases
        self.bases = before if bases is None else bases
        try:
            yield
        finally:
            self.bases = before


KNOWN = AllKnown()
