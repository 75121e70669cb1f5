"""The bases of a process, found again by the matrices they belong to."""

import threading
from contextlib import contextmanager

import numpy as np

from pymc_features.simulators.reduced.basis import joined, new_basis, new_terms
from pymc_features.simulators.reduced.candidates import candidates, complete, with_signs

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
        """Whether it is about these structures."""
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
