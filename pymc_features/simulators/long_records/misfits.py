"""Misfits and gradients of structures under a long record: from a table, and by the march where not sure.

A structure's numbers do not depend on the others of its population, nor on what the table was asked before.
"""

import numpy as np

from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.long_records.sums import evaluate_slopes, evaluate_values
from pymc_features.simulators.long_records.table import Table

CHUNK = 1024  # particles at a time
ROUNDING = 5e-15  # errors of a sum, relative to their sizes: ten times what was found
SURE = 1e-8  # error of e_j that makes no difference to TN and EXP
NATS = 1e-3  # error of the log-likelihood of independent samples, whose variance is near e_j
AGREEMENT = 1e-6  # with the march
ALONE = {"population_discrepancy": "discrepancy", "population_gradient": "misfit_gradient"}


class Tables:
    """The table of one node of a compiled function, kept until other data come."""

    def __init__(self):
        self.table = None

    def __reduce__(self):
        return Tables, ()

    def of(self, observed, excitation) -> Table:
        """The table of data (s, N) under an excitation, known or new."""
        if self.table is None or not self.table.is_of(observed, excitation):
            self.table = Table(observed, excitation)
        return self.table


class Asked:
    """Structures, and what is asked of them.

    Parameters
    ----------
    family : Family
    arguments : tuple
        Parameters, with a row for each particle or one for all, `Excitation` with one input and `Outputs`.
    observed : array (s, N)
    weights : array (p, s, 1), optional
        Of e_j, whose weighted sum is differentiated.
    is_alone : bool
        Whether there is one structure, to be marched by the kernels for one.
    """

    def __init__(self, family, arguments, observed, weights=None, is_alone=False):
        self.family, self.arguments, self.observed = family, arguments, observed
        self.weights, self.is_alone, self.names = weights, is_alone, tuple(family.parameters)
        self.kernel = "population_discrepancy" if weights is None else "population_gradient"
        self.rows = max(getattr(arguments[0], name).shape[0] for name in self.names)

    def some(self, which):
        """Some of these structures, by their numbers."""
        parameters, *shared = self.arguments
        own = {name: getattr(parameters, name) for name in self.names}
        own = {name: np.ascontiguousarray(x[which]) for name, x in own.items() if x.shape[0] > 1}
        weights = None if self.weights is None else self.weights[which]
        arguments = parameters._replace(**own), *shared
        return Asked(self.family, arguments, self.observed, weights, self.is_alone)

    def march(self) -> tuple:
        """What the march gives: e_j (p, s), or gradients of the shapes of the parameters."""
        parameters, *shared = self.arguments
        more = (self.observed,) if self.weights is None else (self.observed, self.weights)
        kernel = self.kernel
        if self.is_alone:
            kernel, more = ALONE[kernel], (self.observed, *(x[0] for x in more[1:]))
            parameters = parameters._replace(**{name: getattr(parameters, name)[0] for name in self.names})
        found = self.family.kernels[kernel](parameters, *shared, *more)
        found = (found,) if isinstance(found, np.ndarray) else found
        return tuple(x[None] for x in found) if self.is_alone else tuple(found)

    def by_table(self, table) -> tuple | None:
        """Misfits from a table, and whether each is sure (p,); None where there are no modes, or no table."""
        (parameters, excitation, wanted), is_value = self.arguments, self.weights is None
        kernel = self.family.kernels["population_systems" if is_value else "gradient_systems"]
        systems = kernel(parameters, excitation, wanted, self.observed)
        if systems is None:
            return None
        (count, s, m), n_times, step = systems.shapes.shape, self.observed.shape[1], table.mesh.step
        n_rows = 2 * s if is_value else 2 * s + (s + 2) * m
        factors = np.empty((0, s)) if is_value else (-2.0 / n_times) * self.weights[:, :, 0]
        for _ in range(2):  # again when the nodes that were missing are filled
            result = np.full((-(-count // LANES), n_rows, LANES), np.inf)
            reach = np.array([[2**62], [-(2**62)]]) + np.zeros(table.mesh.begins.size, dtype=int)
            evaluated = evaluate_values if is_value else evaluate_slopes
            evaluated(systems, table.mesh, factors, wanted.quantity, reach, result)
            if not (reach[0] <= reach[1]).any():
                break
            if not table.cover(reach):
                table.is_left = True
                return None
        found = result.swapaxes(1, 2).reshape(-1, n_rows)[:count]
        squares, sizes, outputs, by_s, by_d = np.split(found, np.cumsum((s, s, s * m, m)), axis=1)
        bound = min(SURE, 2.0 * NATS / (n_times * s))
        is_sure = (ROUNDING * sizes**2 < bound * squares).all(axis=1)
        if is_value:
            return (squares / n_times,), is_sure
        return (outputs.reshape(count, s, m), by_s * step**2, by_d * step), is_sure

    def evaluate(self, table) -> tuple | None:
        """What `march` gives, from the table where it is sure; None without one."""
        found = None if table.is_left else self.by_table(table)
        if found is None:
            return None
        sums, is_sure = found
        if is_sure.all():
            return self.finished(sums)
        names = self.names if self.weights is not None else ()
        shapes = [getattr(self.arguments[0], name).shape for name in names] or [sums[0].shape]
        totals = tuple(map(np.zeros, shapes))
        for which in (np.flatnonzero(is_sure), np.flatnonzero(~is_sure)):
            if which.size:
                own = self.some(which)
                parts = own.finished([x[which] for x in sums]) if is_sure[which[0]] else own.march()
                for total, part in zip(totals, parts, strict=True):
                    if len(total) > 1:
                        total[which] = part
                    else:
                        total += part
        return totals

    def finished(self, sums) -> tuple:
        """Sums over time as e_j, which they are, or as gradients."""
        kernels = self.family.kernels
        return (
            tuple(sums) if self.weights is None else kernels["gradient_of_sums"](*self.arguments, tuple(sums))
        )

    def agrees(self, table) -> bool:
        """Whether table and march give the same for a few of the structures."""
        some = self.some(np.unique(np.linspace(0, self.rows - 1, LANES).astype(int)))
        for own, other in zip(some.evaluate(table), some.march(), strict=True):
            scale = abs(other) if self.weights is None else abs(np.nan_to_num(other)).max(initial=0.0)
            if not ((abs(own - other) <= AGREEMENT * scale) | (np.isnan(own) & np.isnan(other))).all():
                return False
        return True


def from_table(tables: Tables, asked: Asked) -> tuple:
    """What `Asked.march` gives, from a table where that is sure."""
    table = tables.of(asked.observed, asked.arguments[1])
    found = asked.evaluate(table)
    if found is not None and asked.kernel not in table.checked:
        table.checked.add(asked.kernel)
        table.is_left = not asked.agrees(table)
    return asked.march() if found is None or table.is_left else found
