"""Tables kept with their data, found again without reading these.

A model asks for the same data thousands of times. They are known again by the memory in which they lie, as
long as its owner is alive, and by some of their values; now and then all are compared (`same`), and always
where the owner is gone, as it is of constants in compiled graphs. Other memory with the same content finds
the same table by its hash.
"""

import hashlib
import weakref

import numpy as np

from pymc_features.simulators.mean_squares.correlations import correlations
from pymc_features.simulators.mean_squares.table import Table
from pymc_features.simulators.oscillators.arguments import interpolate

MOST_TABLES = 4  # of all data in a process; the one not asked for longest goes first
PROBES = 64  # values of an array that are compared whenever it comes by


class Data:
    """Data and inputs, with their tables.

    Attributes
    ----------
    has_tables : bool
        Not of data with gaps, nor of numbers that are not finite.
    until_check : dict
        Particles to be evaluated by each kernel before the next comparison with the march.
    """

    def __init__(self, observed, acceleration, excitation):
        self.observed, self.acceleration = observed.copy(), acceleration.copy()
        self.excitation, self.until_check, self.made = excitation, {}, {}
        self.has_tables = bool(np.isfinite(observed).all() and np.isfinite(acceleration).all())

    def tables(self, n_statistics):
        """The table of the misfit and, for four statistics, that of its increments; none if there is none."""
        if not self.has_tables:
            return ()
        return tuple(self.table(of_increments) for of_increments in (False, True)[: 1 + (n_statistics == 4)])

    def table(self, of_increments):
        """The table of the misfit or of its increments, made when it is first asked for."""
        if of_increments not in self.made:
            _, dt, substeps, stride, direct = self.excitation
            n_times = self.observed.shape[1]
            ground = np.empty((len(self.acceleration), stride * (n_times - 1) + 1))
            for i, row in enumerate(ground):
                interpolate(self.acceleration[i], substeps, 0, row)
            own = direct[0][:, :n_times] if direct.size else np.empty((0, n_times))
            self.made[of_increments] = Table(
                correlations(self.observed, ground, own, dt / substeps, of_increments)
            )
        return self.made[of_increments]

    def drop_tables(self):
        """March from now on."""
        self.has_tables, self.made = False, {}

    def same(self, observed, acceleration) -> bool:
        """Whether all values are those of the table."""
        return np.array_equal(self.observed, observed) and np.array_equal(self.acceleration, acceleration)


class Kept:
    """The tables of a process."""

    def __init__(self):
        self.by_content, self.by_memory = {}, {}

    def of(self, observed, excitation) -> Data:
        """Data (s, N) under inputs (t,) or (d, t), known or new."""
        acceleration = np.atleast_2d(excitation.acceleration)
        memory = (place(observed), place(acceleration), *map(float, excitation[1:4]), excitation.direct.shape)
        found = self.by_memory.get(memory)
        if found is not None:
            owners, probes, data = found
            alive = all(owner() is not None for owner in owners)
            if probes == probe(observed) + probe(acceleration) and (
                alive or data.same(observed, acceleration)
            ):
                return data
            del self.by_memory[memory]
        data = self.by_hash(observed, acceleration, excitation)
        owners = weakref.ref(owner_of(observed)), weakref.ref(owner_of(acceleration))
        while len(self.by_memory) >= 4 * MOST_TABLES:
            del self.by_memory[next(iter(self.by_memory))]
        self.by_memory[memory] = owners, probe(observed) + probe(acceleration), data
        return data

    def by_hash(self, observed, acceleration, excitation):
        """Data with this content."""
        digest = hashlib.sha256(repr((observed.shape, acceleration.shape, *excitation[1:4])).encode())
        digest.update(np.ascontiguousarray(observed))
        digest.update(np.ascontiguousarray(acceleration))
        digest.update(np.ascontiguousarray(excitation.direct[:1]))
        key = digest.digest()
        data = self.by_content.pop(key, None) or Data(observed, acceleration, excitation)
        self.by_content[key] = data  # the last one asked for comes last
        while len(self.by_content) > MOST_TABLES:
            gone = self.by_content.pop(next(iter(self.by_content)))
            self.by_memory = {at: known for at, known in self.by_memory.items() if known[2] is not gone}
        return data

    def forget(self, data):
        """Drop what has been changed in place."""
        self.by_memory = {at: known for at, known in self.by_memory.items() if known[2] is not data}


def owner_of(array):
    """The array to which the memory of a view belongs."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def place(array):
    """Where an array lies in memory."""
    return array.ctypes.data, array.shape, array.strides


def probe(array) -> bytes:
    """Some of the values of an array, by their bits."""
    return array[:, :: max(1, array.shape[1] // PROBES)].tobytes()


KEPT = Kept()
