"""Sums over time that a gradient needs, from a table, for one structure in each lane of a vector register."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, magnitude, splat
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number, write_lanes
from pymc_features.simulators.mean_squares.gradient.memory import (
    END,
    N_NUMBERS,
    OF_INPUT,
    SIZE,
    SLOPE,
    TOTAL,
    fill_lane,
    new_workspace,
)
from pymc_features.simulators.mean_squares.gradient.pairs import own_size, take_pair
from pymc_features.simulators.mean_squares.gradient.poles import (
    finish,
    inverse,
    plus,
    prepare,
    scaled,
    take_functions,
    times,
)
from pymc_features.simulators.mean_squares.poles import write_entries
from pymc_features.simulators.mean_squares.table import N_ROWS
from pymc_features.simulators.mean_squares.waves import load_pair
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY


class Derivatives(NamedTuple):
    """Derivatives of a number L by what the modes of many structures do over time.

    Attributes
    ----------
    squares, sizes : array (p, s)
        Sums of squared misfits, and what their rounding errors are relative to.
    outputs : array (p, s, m)
        sum_k dL/dy_j f_r, f the output of a mode of unit participation, an acceleration less the input.
    by_square, by_damping : array (p, m)
        By omega^2 at the same D and shapes, and by D.
    """

    squares: np.ndarray
    sizes: np.ndarray
    outputs: np.ndarray
    by_square: np.ndarray
    by_damping: np.ndarray


def new_derivatives(n_particles, n_sensors, n_modes):
    """Room for the derivatives of structures; sizes are infinite where nothing is written."""
    return Derivatives(
        np.full((n_particles, n_sensors), np.nan),
        np.full((n_particles, n_sensors), np.inf),
        np.zeros((n_particles, n_sensors, n_modes)),
        np.zeros((n_particles, n_modes)),
        np.zeros((n_particles, n_modes)),
    )


@jit
def derive_pole(own, r, quantity):
    """Derivatives of L by omega^2 and by D of mode r, which is less than critically damped.

    With lambda = -D/2 + i omega_d, omega_d^2 = omega^2 - D^2/4, and C ~ lambda^q / omega_d.
    """
    sigma, omega = load_pair(own.numbers, N_NUMBERS * r)
    total, slope = load_pair(own.modes, own.n_rows * r + TOTAL), load_pair(own.modes, own.n_rows * r + SLOPE)
    order = 2.0
    if quantity == RELATIVE_DISPLACEMENT:
        order = 0.0
    if quantity == RELATIVE_VELOCITY:
        order = 1.0
    by_pole = plus(slope, scaled(order, times(total, inverse(0.0 - sigma, omega))))
    frequency = 0.5 / omega  # d(omega_d)/d(omega^2)
    own_square = frequency * (0.0 - total[0] / omega - by_pole[1])
    # d(omega_d)/dD = -sigma d(omega_d)/d(omega^2)
    return 2.0 * own_square, 0.0 - by_pole[0] - 2.0 * sigma * own_square


@jit
def write_lane_sums(own, quantity, found, places, count):
    """Write the results of all lanes; `places` are the structures' numbers."""
    m, n_sensors = own.n_modes, own.n_sensors
    relative = quantity != RELATIVE_DISPLACEMENT and quantity != RELATIVE_VELOCITY
    outputs, lanes_of = np.empty((1, LANES)), np.empty((2, LANES))
    address, both = outputs.ctypes.data, lanes_of.ctypes.data
    for j in range(n_sensors):
        feed, factor, end = read_lanes(own.feed, j), read_lanes(own.factors, j), read_lanes(own.ends, j)
        with_input = read_number(own.data_products, j)
        squares = splat(read_number(own.data_squares, j)) + feed * (own.square * feed - 2.0 * with_input)
        spread = splat(np.sqrt(read_number(own.data_squares, j))) + np.sqrt(own.square) * magnitude(feed)
        of_input = own.square * feed - with_input
        for r in range(m):
            share = read_lanes(own.scaled, j * m + r)
            q = 2.0 * read_lanes(own.modes, own.n_rows * r + OF_INPUT)
            product = read_lanes(own.products, j * m + r)
            squares = squares + share * (product + 2.0 * (feed * q - read_lanes(own.data, j * m + r)))
            spread = spread + magnitude(share) * read_lanes(own.modes, own.n_rows * r + SIZE)
            of_input = of_input + share * q
        of_input = factor * of_input - end * own.own_last - read_lanes(own.starts, j) * own.own_first
        write_lanes(both, 0, squares)
        write_lanes(both, 1, spread * spread)
        for lane in range(count):
            found.squares[places[lane], j] = lanes_of[0, lane]
            found.sizes[places[lane], j] = lanes_of[1, lane]
        for r in range(m):
            q = 2.0 * read_lanes(own.modes, own.n_rows * r + OF_INPUT)
            product = read_lanes(own.products, j * m + r) + feed * q - read_lanes(own.data, j * m + r)
            product = factor * product - end * (2.0 * read_lanes(own.modes, own.n_rows * r + END))
            write_lanes(address, 0, product - of_input if relative else product)
            for lane in range(count):
                found.outputs[places[lane], j, r] += outputs[0, lane]
    for r in range(m):
        by_square, by_damping = derive_pole(own, r, quantity)
        write_lanes(both, 0, by_square)
        write_lanes(both, 1, by_damping)
        for lane in range(count):
            found.by_square[places[lane], r] += lanes_of[0, lane]
            found.by_damping[places[lane], r] += lanes_of[1, lane]


@jit
def derive(table, systems, poles, weights, quantity, room, found):
    """Add to `Derivatives` those of L = sum weights times sums of squares, last and first misfits.

    Rows of structures that the mesh does not serve stay as they are.

    Parameters
    ----------
    table : tuple
        `Mesh` and `Sums`, of one input, and the two arrays of `stencil.coefficients` for derivatives.
    systems, poles
        As in `evaluate`; no mode of those served is overdamped.
    weights : array (p, s, 3)
        Derivatives of L by the sum of squared misfits, and by the last and the first misfit.
    quantity : int
        Position in `QUANTITIES`.
    room : array
        From `memory.room_of`.
    found : Derivatives
    """
    mesh, sums, slopes = table
    n_modes, served = systems.omega.shape[1], np.flatnonzero(poles.served)
    own = new_workspace(room, mesh, sums, slopes, n_modes)
    spacing = np.repeat(mesh.spacing, N_ROWS)
    entries = np.empty(poles.rows.shape, dtype=np.int64)
    write_entries(poles, mesh, own.node, entries)
    zero = splat(0.0)
    for first in range(0, served.size, LANES):
        places = served[first : first + LANES]
        for lane in range(LANES):
            fill_lane(own, lane, systems, poles, spacing, weights, places[min(lane, places.size - 1)])
        for i in range(n_modes * own.n_sensors):
            write_lanes(own.products, i, zero)
        for r in range(n_modes):
            prepare(own, r)
            for lane in range(places.size):
                take_functions(own, lane, entries[places[lane], r])
            finish(own, r)
        for r in range(n_modes):
            write_lanes(own.modes, own.n_rows * r + SIZE, own_size(own, r))
            for q in range(r + 1):
                take_pair(own, r, q)
        write_lane_sums(own, quantity, found, places, places.size)
