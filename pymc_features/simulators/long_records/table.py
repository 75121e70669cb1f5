"""Tables of one set of data: functions of the poles at nodes in their plane, filled where modes come by.

At z = (-sigma + i omega) h what lies behind e^(-sigma t) = 1e-16 counts for nothing. Level k takes the first
L / 2^k of L coefficients of the polynomials and serves 37 <= sigma T / 2^k < 74, level 0 all sigma below. Its
spacing in both directions is 2 pi / (M h), three times as fine as so many coefficients need, and one real FFT
of length M gives a function along a whole row of nodes.
"""

import numpy as np
from scipy import fft

from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import aligned
from pymc_features.simulators.long_records.stencil import OVERSAMPLING, coefficients, window
from pymc_features.simulators.long_records.sums import N_ROWS, Mesh
from pymc_features.simulators.oscillators.arguments import interpolate

SHORTEST = 128  # coefficients of the last level, so that sigma h is below 0.6
MARGIN = 32  # columns filled beyond those that are needed
MOST_BYTES = 2**28  # of values


class Table:
    """Functions of data (s, N) under the one input of an excitation.

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
