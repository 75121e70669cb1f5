"""Poles of the modes of many structures, and their places on the mesh."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.mean_squares.stencil import REACH
from pymc_features.simulators.mean_squares.systems import Systems
from pymc_features.simulators.mean_squares.table import DECAYED, N_ROWS, Mesh
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY

FASTEST = 25.0  # omega h of a pole that is evaluated


class Poles(NamedTuple):
    """lambda = -sigma + i omega_d, each standing for itself and its conjugate, two to an overdamped mode.

    Attributes
    ----------
    served : bool array (p,)
        Whether all poles of a structure lie on the mesh.
    numbers : array (p, S, 6)
        sigma and omega_d [1/s]; real and imaginary part of C, with which the output is 2 Re(C v); nu, the
        distance from the nearest node in spacings, omega_d in its real part and sigma in its imaginary one.
    rows, columns : integer array (p, S)
        Level times N_ROWS plus row, and column, of that node.
    """

    served: np.ndarray
    numbers: np.ndarray
    rows: np.ndarray
    columns: np.ndarray


@jit
def gain_of(sigma, omega, gain, quantity):
    """C h^-1 = gain lambda^q, q the number of derivatives of the displacement."""
    z = complex(-sigma, omega)
    if quantity == RELATIVE_VELOCITY:
        return gain * z
    return gain if quantity == RELATIVE_DISPLACEMENT else gain * z * z


@jit
def place_of(mesh, sigma, omega):
    """Row, column and distance of the nearest node; row -1 if the mesh does not reach there."""
    if not (omega * mesh.step <= FASTEST and sigma >= 0.0):  # NaN too
        return -1, 0, 0.0, 0.0
    level, duration = 0, mesh.duration
    while sigma * duration >= 2.0 * DECAYED:
        level += 1
        duration *= 0.5
    if level >= mesh.spacing.size:
        return -1, 0, 0.0, 0.0
    spacing = mesh.spacing[level]
    across, along = sigma / spacing, omega / spacing
    row, column = np.rint(across), np.rint(along)
    return level * N_ROWS + int(row), int(column), along - column, across - row


@jit
def find_poles(systems: Systems, mesh: Mesh, quantity, lowest, highest):
    """Poles of all structures; the columns of the mesh that they need are added to `lowest` and `highest`."""
    n_particles, m = systems.omega.shape
    n_poles = m
    for p in range(n_particles):
        for r in range(m):
            if systems.valid[p] and systems.omega[p, r] <= 0.5 * systems.damping[p, r]:
                n_poles = 2 * m
    served = systems.valid.copy()
    numbers = np.empty((n_particles, n_poles, 6))
    rows = np.zeros((n_particles, n_poles), dtype=np.int64)
    columns = np.zeros((n_particles, n_poles), dtype=np.int64)
    low, high = lowest.reshape(lowest.size), highest.reshape(highest.size)
    for p in range(n_particles):
        for r in range(n_poles):
            sigma, omega, gain = pole_of(systems.omega[p, r % m], systems.damping[p, r % m], r >= m)
            seen = quantity
            if systems.in_pairs:
                seen = RELATIVE_DISPLACEMENT if r % m < m // 2 else RELATIVE_VELOCITY
            gain = -mesh.step * gain_of(sigma, omega, gain, seen)
            row, column, along, across = place_of(mesh, sigma, omega)
            served[p] &= row >= 0
            own = numbers[p, r]
            own[0], own[1], own[2], own[3], own[4], own[5] = sigma, omega, gain.real, gain.imag, along, across
            rows[p, r], columns[p, r] = row, column
        if served[p]:
            for r in range(n_poles):
                row, column = rows[p, r], columns[p, r]
                low[row], high[row] = min(low[row], column - REACH), max(high[row], column + REACH)
    return Poles(served, numbers, rows, columns)


@jit
def pole_of(omega, damping, is_second):
    """sigma, omega_d, and what stands before the pole in the displacement.

    Of an overdamped mode the slow pole or the second, fast one, by halves, since conjugates are added. The
    second pole of any other mode is its first, and nothing stands before it.
    """
    half = 0.5 * damping
    if omega > half:
        damped = np.sqrt((omega - half) * (omega + half))
        return half, damped, complex(0.0, 0.0 if is_second else -0.5 / damped)
    root = np.sqrt((half - omega) * (half + omega))
    fast, gain = half + root, 0.25 / root
    if is_second:
        return fast, 0.0, complex(-gain, 0.0)
    return omega * (omega / fast), 0.0, complex(gain, 0.0)


@jit
def write_entries(poles: Poles, mesh: Mesh, node, entries):
    """Write where the node farthest to the left in the stencil of each pole begins, in vectors, (p, S)."""
    begins, lowest = mesh.begins.reshape(mesh.begins.size), mesh.lowest.reshape(mesh.lowest.size)
    for p in range(entries.shape[0]):
        if poles.served[p]:
            for r in range(entries.shape[1]):
                row = poles.rows[p, r]
                entries[p, r] = begins[row] + (poles.columns[p, r] - REACH - lowest[row]) * node
