"""What is asked of many structures under a record: modes for the tables, and the march of some of them."""

import numpy as np

from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.mean_squares.poles import find_poles
from pymc_features.simulators.mean_squares.table import MOST_BYTES, empty_reach

CHUNK = 1024  # particles at a time
ALONE = {  # kernels of a structure by itself
    "population_discrepancy": "discrepancy",
    "population_misfit": "misfit",
    "population_gradient": "misfit_gradient",
}


class Asked:
    """Structures, and what is common to them.

    Parameters
    ----------
    family : Family
    arguments : tuple
        Parameters, with a row for each particle or one for all, `Excitation` and `Outputs`.
    data : Data
    is_alone : bool
        Whether there is one structure, to be marched by the kernels for one.
    """

    def __init__(self, family, arguments, data, is_alone=False):
        self.parameters, given, self.wanted = arguments
        self.family, self.data, self.is_alone = family, data, is_alone
        self.excitation = given._replace(acceleration=data.acceleration.reshape(given.acceleration.shape))
        self.rows = max(getattr(self.parameters, name).shape[0] for name in family.parameters)

    @property
    def shared(self):
        """Arguments behind the parameters: `Excitation`, `Outputs` and data."""
        return self.excitation, self.wanted, self.data.observed

    def parameters_of(self, which):
        """Parameters of some particles."""
        if which is None:
            return self.parameters
        own = {name: getattr(self.parameters, name) for name in self.family.parameters}
        own = {name: np.ascontiguousarray(x[which]) for name, x in own.items() if x.shape[0] > 1}
        return self.parameters._replace(**own)

    def march(self, kernel, which=None, *more):
        """What the recursion gives for some particles, or for all; `more` are arguments behind the data."""
        own = self.parameters_of(which)
        if not self.is_alone:
            return self.family.kernels[kernel](own, *self.shared, *more)
        own = own._replace(**{name: getattr(own, name)[0] for name in self.family.parameters})
        found = self.family.kernels[ALONE[kernel]](own, *self.shared, *(x[0] for x in more))
        return found[None] if isinstance(found, np.ndarray) else tuple(x[None] for x in found)

    def parts(self, kernel, tables, chunk=CHUNK):
        """Yield numbers of particles, `Systems` and `Poles`, which the tables cover then; few at a time.

        Nothing is yielded of structures that have no `Systems`.
        """
        waiting = [np.arange(i, min(i + chunk, self.rows)) for i in range(0, self.rows, chunk)][::-1]
        while waiting:
            part = waiting.pop()
            whole = len(part) == self.rows
            systems = self.family.kernels[kernel](self.parameters_of(None if whole else part), *self.shared)
            if systems is None:
                return
            mesh = tables[0].mesh
            lowest, highest = empty_reach(mesh)
            poles = find_poles(systems, mesh, self.wanted.quantity, lowest, highest)
            if len(part) > 1 and tables[0].size_of(lowest, highest) > MOST_BYTES:
                half = len(part) // 2
                waiting += [part[half:], part[:half]]
                continue
            if any([table.cover(lowest, highest) for table in tables]):
                self.data.until_check.clear()
            yield part, systems, poles

    def is_due(self, kernel):
        """Whether to compare some particles with the march; a vector of them in N costs a twentieth."""
        until_check, n_times = self.data.until_check, self.data.observed.shape[1]
        is_due = until_check.get(kernel, 0) <= 0
        until_check[kernel] = (n_times if is_due else until_check[kernel]) - self.rows
        return is_due

    @property
    def some(self):
        """Numbers of a few particles, for that comparison."""
        return np.unique(np.linspace(0, self.rows - 1, LANES).astype(int))
