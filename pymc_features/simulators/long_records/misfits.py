"""Misfits and gradients of structures under a long record: from a table, and by the march where not sure.

A structure's numbers do not depend on the others of its population, nor on what the table was asked before.
"""

import numpy as np
from scipy import fft

from pymc_features.simulators.long_records.stencil import OVERSAMPLING, coefficients, window
from pymc_features.simulators.long_records.sums import N_ROWS, Mesh, evaluate_slopes, evaluate_values
from pymc_features.simulators.numbers.vectors import LANES, aligned
from pymc_features.simulators.oscillators.arguments import interpolate

SHORTEST = 128  # coefficients of the last level, so that sigma h is below 0.6
MARGIN = 32  # columns filled beyond those that are needed
MOST_BYTES = 2**28  # of values


class Table:
    """Functions of the poles for data (s, N) under the one input of an excitation, at nodes in their plane.

    At z = (-sigma + i omega) h what lies behind e^(-sigma t) = 1e-16 counts for nothing. Level k takes the
    first L / 2^k of L coefficients of the polynomials and serves 37 <= sigma T / 2^k < 74, level 0 all sigma
    below. Its spacing in both directions is 2 pi / (M h), three times as fine as so many coefficients need,
    and one real FFT of length M gives a function along a whole row of nodes.

    Attributes
    ----------
    mesh : Mesh
    is_left : bool
        Whether it is not asked any more: of data with gaps, where it would be too large, and once it has
        differed from the march.
    checked : set of str
        Kernels compared with the march since nodes were filled.

    Notes
    -----
    The values at a node do not depend on when it is filled, nor on what is filled besides. Each row costs an
    FFT of three times the record for each function.
    """

    def __init__(self, observed, excitation):
        acceleration, *self.grid, direct = excitation
        self.given = tuple(x.copy() for x in (observed, acceleration, direct[:1]))
        self.is_left, self.checked = not all(np.isfinite(x).all() for x in self.given), set()
        if not self.is_left:
            self.begin(observed, acceleration.reshape(-1), direct)

    def is_of(self, observed, excitation) -> bool:
        """Whether all values are those of the table."""
        acceleration, *grid, direct = excitation
        given = observed, acceleration, direct[:1]
        return grid == self.grid and all(map(np.array_equal, self.given, given))

    def begin(self, observed, acceleration, direct):
        """Correlate record and data, and make the mesh without nodes."""
        (s, n_times), (dt, substeps, stride) = observed.shape, self.grid
        n_steps, step = n_times * stride, dt / substeps
        ground = np.empty(n_steps)  # zero behind the record
        interpolate(acceleration, substeps, 0, ground)
        own = direct[0, :, :n_times] if direct.size else ground[None, ::stride]
        phases = ground.reshape(n_times, stride).T
        rows = np.zeros((s + stride + 1 + (direct.size > 0), n_steps + 1))
        rows[: s + stride, :-1:stride] = np.concatenate([observed, phases])
        rows[s + stride, -1] = 1.0
        rows[s + stride + 1 :, :-1:stride] = own[: len(rows) - s - stride - 1]
        size = fft.next_fast_len(2 * n_steps + 2, real=True)
        correlated = fft.irfft(fft.rfft(rows, size) * np.conj(fft.rfft(ground, size)), size)
        polynomials = correlated[:, 1 : n_steps + 2]
        polynomials[:, -1] = 0.0
        self.polynomials = np.concatenate([polynomials, rows])
        self.vectors = -(-len(self.polynomials) // LANES)
        self.node = 2 * LANES * self.vectors  # numbers
        length = n_steps + 1
        levels = max(1, int(np.log2(length / SHORTEST)) + 1)
        self.lengths = [length >> k for k in range(levels)]
        self.periods = [2 * OVERSAMPLING * fft.next_fast_len(-(-(n + 1) // 2)) for n in self.lengths]
        spacing, empty = 2.0 * np.pi / (step * np.array(self.periods)), np.zeros(levels * N_ROWS, dtype=int)
        self.mesh = Mesh(
            length * step,
            step,
            spacing,
            empty,
            empty + 1,
            empty.copy(),
            np.empty(0),
            *coefficients(),
            np.einsum("jt,jt->j", observed, observed),
            observed @ own[0],
            own @ own[0],
            rows[:, :-1:stride] @ phases[0],
            phases @ phases.T,
            ground[0],
            len(rows) - 1 if direct.size else s,
        )

    def cover(self, reach) -> bool:
        """Fill columns `reach` (2, levels N_ROWS) of each row, unless the first is larger; False if too many.

        Everything else is dropped if it would not fit into the memory.
        """
        mesh, needed = self.mesh, reach[0] <= reach[1]
        lowest, highest = np.where(needed, reach + [[-MARGIN], [MARGIN]], [[1], [0]])
        known = mesh.lowest <= mesh.highest
        for is_kept in (known, known & False):
            both = is_kept & needed
            low = np.where(both, np.minimum(lowest, mesh.lowest), np.where(is_kept, mesh.lowest, lowest))
            high = np.where(both, np.maximum(highest, mesh.highest), np.where(is_kept, mesh.highest, highest))
            sizes = high - low + 1
            if sizes.sum() * self.node * 8 <= MOST_BYTES:
                break
        else:
            return False
        begins = np.cumsum(sizes) - sizes
        values = aligned(int(sizes.sum()) * self.node)
        for row in np.flatnonzero(sizes):
            own = values[begins[row] * self.node :][: sizes[row] * self.node]
            if needed[row]:
                own[:] = self.nodes(row, low[row], high[row]).ravel()
            else:
                own[:] = mesh.values[mesh.begins[row] * self.node :][: own.size]
        self.mesh = mesh._replace(begins=begins, lowest=low, highest=high, values=values)
        self.checked.clear()
        return True

    def nodes(self, row: int, low: int, high: int) -> np.ndarray:
        """Values (columns, vectors, 2, LANES) of one row of nodes, from column `low` to `high`."""
        level, row = divmod(row, N_ROWS)
        length, period = self.lengths[level], self.periods[level]
        shift, time = period // (2 * OVERSAMPLING), np.arange(length)
        factor = np.exp(-row * self.mesh.spacing[level] * self.mesh.step * time)
        factor /= window((time - shift) * (2.0 * np.pi / period))
        found = np.zeros((high - low + 1, self.vectors, 2, LANES))
        column = np.arange(low, high + 1) % period  # the functions are periodic in omega
        is_mirrored = column > period // 2
        column = np.where(is_mirrored, period - column, column)
        sign = np.where(is_mirrored, 1.0, -1.0)  # the FFT has the other sign of i
        series = np.zeros(period)
        for f, polynomial in enumerate(self.polynomials):
            weighted = factor * polynomial[:length]
            series[: length - shift], series[-shift:] = weighted[shift:], weighted[:shift]
            spectrum = fft.rfft(series)[column]
            found[:, f // LANES, 0, f % LANES] = spectrum.real
            found[:, f // LANES, 1, f % LANES] = sign * spectrum.imag
        return found


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
        found = self.family.of_squares(kernel)(parameters, *shared, *more)
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
        sums = tuple(map(np.ascontiguousarray, sums))  # for each layout of each the kernel is compiled anew
        if self.weights is None:
            return sums
        return self.family.kernels["gradient_of_sums"](*self.arguments, sums)

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
