"""The bases of a process, found again by the matrices they belong to."""

import numpy as np

from pymc_features.simulators.linear.arguments import Arguments
from pymc_features.simulators.linear.system import admissible_modes, solve_system
from pymc_features.simulators.reduced.basis import joined, new_basis, new_terms

MOST_STRUCTURES = 4  # of which bases are kept; the one not asked for longest goes first
MOST_COLUMNS = 400
GUARDS = 3  # one more mode for so many is solved for, since the highest ones change places with those above
FEWEST = 8  # structures asked for before a basis is begun
ARRAYS = "stiffness", "mass", "damping", "influence", "rows", "starts"


class Known:
    """What is known of structures that share their matrices."""

    def __init__(self, given, n_modes):
        self.given = given._replace(**{name: getattr(given, name).copy() for name in ARRAYS})
        self.n_modes, self.asked = n_modes, 0
        self.terms, self.basis, self._reduced = None, None, None
        self.solved = 0

    def fits(self, given, n_modes) -> bool:
        """Whether it is about these structures."""
        pairs = [(getattr(self.given, name), getattr(given, name)) for name in ARRAYS]
        return self.n_modes == n_modes and all(x.shape == y.shape for x, y in pairs) and all(
            np.array_equal(x, y) for x, y in pairs
        )

    @property
    def is_begun(self) -> bool:
        """Whether there are more columns than modes."""
        return self.basis is not None and self.basis.size > self.n_modes + 1

    def solve(self, a: Arguments):
        """The `System` of one structure, solved in full; its modes join the basis, and some more above them."""
        given, m = a.parameters, self.n_modes
        if not given.is_finite:
            return None
        mass, stiffness = given.assemble(given.mass), given.assemble(given.stiffness)
        factor, *modes = admissible_modes(mass, stiffness, m + m // GUARDS)
        system = solve_system(a, known=modes) if modes else None
        if system is None:
            return None
        system = system._replace(factor=factor)
        if system.omega[0] > 0.0:
            self.solved += 1
            if self.terms is None:
                self.terms = new_terms(self.given, system)
                self.basis = new_basis(self.terms)
            grown = joined(self.terms, self.basis, modes[1])
            if grown.size > MOST_COLUMNS:
                grown = joined(self.terms, new_basis(self.terms), modes[1])
            self.basis = grown
        return system

    def reduced(self, a: Arguments) -> Arguments:
        """The arguments of a population in the basis."""
        wanted = a.wanted._replace(sensors=a.wanted.sensors @ self.basis.columns)
        return a._replace(parameters=self.basis.reduced(a.parameters), wanted=wanted)


class AllKnown:
    """The last few."""

    def __init__(self):
        self.entries = []

    def of(self, given, n_modes, count):
        """What is known of these structures; None where a basis is not worth its while."""
        if given.is_dense or given.has_constant_modes or given.n_dof < 8 * n_modes:
            return None
        for entry in self.entries:
            if entry.fits(given, n_modes):
                self.entries.remove(entry)
                break
        else:
            entry = Known(given, n_modes)
        self.entries = [entry, *self.entries[: MOST_STRUCTURES - 1]]
        entry.asked += count
        return entry if entry.asked >= FEWEST else None


KNOWN = AllKnown()
