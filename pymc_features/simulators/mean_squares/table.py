"""Values of the entire functions on a mesh in the plane of the poles, filled where particles come by.

At lambda = -sigma + i omega what lies behind e^(-sigma t) = 1e-16 counts for nothing. Level k of the mesh
takes the first N / 2^k of N lags, steps of the recursion, and serves 37 <= sigma T / 2^k < 74, level 0 all
sigma below. Its spacing in both directions is 2 pi / (L h), three times as fine as so many lags need, and one
real FFT of length L gives a function along a whole row of nodes.
"""

from typing import NamedTuple

import numpy as np
from scipy import fft

from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import aligned
from pymc_features.simulators.mean_squares.correlations import Correlations
from pymc_features.simulators.mean_squares.stencil import OVERSAMPLING, coefficients, window

DECAYED = 37.0  # e^-37 = 1e-16
SHORTEST = 128  # lags of the last level, so that sigma h is below 0.6
N_ROWS = 48  # rows of a level: more than 2 DECAYED (N + 8) / (2 pi / 3 N)
MARGIN = 32  # columns filled beyond those that are needed
MOST_BYTES = 2**28  # of values


class Mesh(NamedTuple):
    """What compiled code reads of a table.

    Attributes
    ----------
    duration, step : float
        N h and h [s].
    spacing : array (levels,)
        Of the nodes [rad/s].
    begins, lowest, highest : integer array (levels, N_ROWS)
        Where a row of nodes begins in `values`, and its first and last column; first beyond last if empty.
    values : array (entries, LANES)
        For each node a vector or more of real parts, and of imaginary parts, of each input.
    even, odd : array (REACH + 1, 7)
        Of the stencil.
    lag_zero : array (d vectors, LANES)
        R[0] of each input.
    """

    duration: float
    step: float
    spacing: np.ndarray
    begins: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray
    values: np.ndarray
    even: np.ndarray
    odd: np.ndarray
    lag_zero: np.ndarray


class Table:
    """Mesh of the functions of one set of data.

    Parameters
    ----------
    of : Correlations

    Notes
    -----
    The values at a node do not depend on when it is filled, nor on what is filled besides. Memory: at most
    `MOST_BYTES`, or what one call of `cover` needs; each row costs an FFT of three times the record for
    each function.
    """

    def __init__(self, of: Correlations):
        self.of = of
        n_inputs, n_functions, n_times = of.lags.shape
        self.vectors = -(-n_functions // LANES)
        self.node = 2 * n_inputs * self.vectors  # entries of `values`
        levels = max(1, int(np.log2(n_times / SHORTEST)) + 1)
        self.lengths = [n_times >> k for k in range(levels)]
        self.periods = [2 * OVERSAMPLING * fft.next_fast_len(-(-(n + 1) // 2)) for n in self.lengths]
        lag_zero = np.zeros((len(of.sums.second), self.vectors * LANES))
        lag_zero[:, :n_functions] = of.lags[: len(lag_zero), :, 0]
        empty = np.zeros((levels, N_ROWS), dtype=np.int64)
        self.mesh = Mesh(
            n_times * of.step,
            of.step,
            2.0 * np.pi / (of.step * np.array(self.periods)),
            empty,
            empty + 1,
            empty.copy(),
            np.empty((0, LANES)),
            *coefficients(),
            lag_zero.reshape(-1, LANES),
        )

    def size_of(self, lowest: np.ndarray, highest: np.ndarray) -> float:
        """Memory [bytes] of columns `lowest` ... `highest` of each row."""
        columns = np.maximum(highest - lowest + 1.0, 0.0) + 2.0 * MARGIN * (lowest <= highest)
        return columns.sum() * self.node * LANES * 8

    def cover(self, lowest: np.ndarray, highest: np.ndarray) -> bool:
        """Fill columns `lowest` ... `highest` of each row, (levels, N_ROWS), unless the first is larger.

        Everything else is dropped if it would not fit into the memory. Returns whether anything was filled.
        """
        mesh = self.mesh
        needed = lowest <= highest
        missing = needed & ((lowest < mesh.lowest) | (highest > mesh.highest) | (mesh.lowest > mesh.highest))
        if not missing.any():
            return False
        known = mesh.lowest <= mesh.highest
        low = np.where(missing, lowest - MARGIN, mesh.lowest)
        high = np.where(missing, highest + MARGIN, mesh.highest)
        grown = missing & known
        low[grown], high[grown] = np.minimum(low, mesh.lowest)[grown], np.maximum(high, mesh.highest)[grown]
        sizes = np.maximum(high - low + 1, 0) * self.node
        if self.size_of(low, high) > MOST_BYTES:
            low = np.where(needed, lowest - MARGIN, 1)
            high = np.where(needed, highest + MARGIN, 0)
            sizes, missing = np.maximum(high - low + 1, 0) * self.node, needed
        begins = (np.cumsum(sizes) - sizes.ravel()).reshape(sizes.shape)
        values = aligned(int(sizes.sum()) * LANES).reshape(-1, LANES)
        for level, row in zip(*np.nonzero(sizes), strict=True):
            at = slice(begins[level, row], begins[level, row] + sizes[level, row])
            if missing[level, row]:
                values[at] = self.nodes(level, row, low[level, row], high[level, row])
            else:
                start = mesh.begins[level, row]
                values[at] = mesh.values[start : start + sizes[level, row]]
        self.mesh = mesh._replace(begins=begins, lowest=low, highest=high, values=values)
        return True

    def nodes(self, level: int, row: int, low: int, high: int) -> np.ndarray:
        """Entries (columns node, LANES) of one row of nodes, from column `low` to `high`."""
        lags, length, period = self.of.lags, self.lengths[level], self.periods[level]
        shift = period // (2 * OVERSAMPLING)
        sigma = row * self.mesh.spacing[level]
        time = np.arange(length)
        factor = np.exp(-sigma * self.of.step * time) / window((time - shift) * (2.0 * np.pi / period))
        n_inputs, n_functions, _ = lags.shape
        found = np.zeros((high - low + 1, n_inputs, 2, self.vectors * LANES))
        column = np.arange(low, high + 1) % period  # the functions are periodic in omega
        mirrored = column > period // 2
        column = np.where(mirrored, period - column, column)
        sign = np.where(mirrored, 1.0, -1.0)  # the FFT has the other sign of i
        series = np.zeros(period)
        for i in range(n_inputs):
            for f in range(n_functions):
                weighted = factor * lags[i, f, :length]
                series[:] = 0.0
                series[: length - shift] = weighted[shift:]
                series[-shift:] = weighted[:shift]
                spectrum = fft.rfft(series)[column]
                found[:, i, 0, f], found[:, i, 1, f] = spectrum.real, sign * spectrum.imag
        return found.reshape(-1, LANES)


def empty_reach(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Columns of rows of which nothing is needed, for `Table.cover`."""
    beyond = np.iinfo(np.int64).max // 2
    return np.full(mesh.begins.shape, beyond), np.full(mesh.begins.shape, -beyond)
