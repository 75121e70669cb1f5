"""Sums of squared misfits from a table, for one structure in each lane of a vector register."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, magnitude, splat
from pymc_features.simulators.compiled.vector_memory import (
    read_lanes,
    read_number,
    write_lanes,
    write_number,
)
from pymc_features.simulators.mean_squares.correlations import Sums
from pymc_features.simulators.mean_squares.pairs import combine
from pymc_features.simulators.mean_squares.poles import Poles, write_entries
from pymc_features.simulators.mean_squares.stencil import TAPS
from pymc_features.simulators.mean_squares.systems import Systems
from pymc_features.simulators.mean_squares.table import Mesh
from pymc_features.simulators.mean_squares.waves import (
    centre_turn,
    hold,
    load_pair,
    product,
    store_pair,
    write_weights,
)
from pymc_features.simulators.mean_squares.work import addresses, fill_lane, new_work


@jit
def prepare_pole(own, r):
    """Write what pole r of all lanes needs before its functions are interpolated."""
    row, n_inputs = 8 * r, own.n_inputs
    sigma, omega = load_pair(own.numbers, row)
    gain_re, gain_im = load_pair(own.numbers, row + 2)
    nu_re, nu_im = load_pair(own.numbers, row + 4)
    turn_re, turn_im = product(*centre_turn(nu_re, nu_im), *load_pair(own.numbers, row + 6))
    write_weights(own.even, own.odd, 1.0, nu_re, nu_im, own.weights)
    grown_re, grown_im, one_re, one_im, two_re, two_im = hold(sigma, omega, own.step)
    rho_re, rho_im = one_re - two_re, one_im - two_im
    e_re = grown_re + 1.0
    size = 1.0 / (e_re * e_re + grown_im * grown_im)
    back_re, back_im = e_re * size, (0.0 - grown_im) * size
    square_re, square_im = product(one_re, one_im, one_re, one_im)
    base_re, base_im = product(*product(square_re, square_im, back_re, back_im), turn_re, turn_im)
    back_re, back_im = product(rho_re, rho_im, back_re, back_im)
    # each phase p, from the last: E^(c-1-p) phi1^2, or rho for phi1^2; E^(c-p) - 1
    square_re, square_im = product(square_re, square_im, gain_re, gain_im)
    whole_re, whole_im = grown_re, grown_im
    for p in range(own.stride - 1, 0, -1):
        for i in range(n_inputs):
            share = read_lanes(own.participation, r * n_inputs + i)
            at = 2 * ((r * n_inputs + i) * own.stride + p)
            store_pair(own.ahead, at, share * square_re, share * square_im)
        square_re, square_im = product(square_re, square_im, e_re, grown_im)
        gain_re, gain_im = product(gain_re, gain_im, e_re, grown_im)
        more_re, more_im = product(whole_re, whole_im, grown_re, grown_im)
        whole_re, whole_im = whole_re + grown_re + more_re, whole_im + grown_im + more_im
    store_pair(own.grown, 2 * r, whole_re, whole_im)
    rho_re, rho_im = product(rho_re, rho_im, gain_re, gain_im)
    gain_re, gain_im = load_pair(own.numbers, row + 2)
    start_re, start_im = product(two_re, two_im, turn_re, turn_im)
    two_re, two_im = product(two_re, two_im, gain_re, gain_im)
    start = splat(0.0)
    for i in range(n_inputs):
        share = read_lanes(own.participation, r * n_inputs + i)
        store_pair(own.ahead, 2 * (r * n_inputs + i) * own.stride, share * rho_re, share * rho_im)
        store_pair(own.now, 2 * (r * n_inputs + i), share * two_re, share * two_im)
        store_pair(own.factors, 4 * i, share * base_re, share * base_im)
        store_pair(own.factors, 4 * i + 2, 0.0 - share * back_re, 0.0 - share * back_im)
        start = start - share * read_number(own.first, i * own.stride)
    store_pair(own.factors, 4 * n_inputs, start * start_re, start * start_im)


@jit
def interpolate(own, entry, lane):
    """One vector of functions, real and imaginary parts, from the nodes that begin at `entry`."""
    re, im, other_re, other_im = splat(0.0), splat(0.0), splat(0.0), splat(0.0)
    weight = lane
    for _ in range(TAPS):
        a_re = splat(read_number(own.weights, weight))
        a_im = splat(read_number(own.weights, weight + LANES))
        f_re, f_im = read_lanes(own.values, entry), read_lanes(own.values, entry + own.vectors)
        re, im = re + a_re * f_re, im + a_re * f_im
        other_re, other_im = other_re + a_im * f_im, other_im + a_im * f_re
        entry, weight = entry + own.node, weight + 2 * LANES
    return re - other_re, im + other_im


@jit
def number_of(address, row, lane):
    """A number of an array (rows, LANES), in every lane."""
    return splat(read_number(address, row * LANES + lane))


@jit
def take_functions(own, r, lane, entry):
    """Interpolate the functions of pole r of one lane, and write C times them into `products`.

    `own` are the `Addresses`, and `entry` is where the node farthest to the left begins.
    """
    gain_re, gain_im = number_of(own.numbers, 8 * r + 2, lane), number_of(own.numbers, 8 * r + 3, lane)
    for v in range(own.vectors):
        re, im = splat(0.0), splat(0.0)
        for i in range(own.blocks):
            own_re, own_im = interpolate(own, entry + 2 * i * own.vectors + v, lane)
            f_re, f_im = number_of(own.factors, 4 * i, lane), number_of(own.factors, 4 * i + 1, lane)
            re, im = re + (f_re * own_re - f_im * own_im), im + (f_re * own_im + f_im * own_re)
            if i < own.n_inputs:
                at_zero = read_lanes(own.lag_zero, i * own.vectors + v)
                re = re + number_of(own.factors, 4 * i + 2, lane) * at_zero
                im = im + number_of(own.factors, 4 * i + 3, lane) * at_zero
        re, im = product(re, im, gain_re, gain_im)
        write_lanes(own.found, 2 * v, re)
        write_lanes(own.found, 2 * v + 1, im)
    for j in range(own.n_sensors):
        found = read_number(own.found, 2 * LANES * (j // LANES) + j % LANES)
        write_number(own.products, j * LANES + lane, 2.0 * found)
    for i in range(own.n_functions):
        f, to = own.n_sensors + i, (own.n_sensors + 2 * i) * LANES + lane
        at = 2 * LANES * (f // LANES) + f % LANES
        write_number(own.products, to, read_number(own.found, at))
        write_number(own.products, to + LANES, read_number(own.found, at + LANES))


@jit
def finish_pole(own, r):
    """Add g'o of pole r to the sums, and write what its products with other poles need."""
    n_sensors, n_inputs, stride = own.n_sensors, own.n_inputs, own.stride
    n_phases = n_inputs * stride
    e_re, e_im = read_lanes(own.grown, 2 * r) + 1.0, read_lanes(own.grown, 2 * r + 1)
    last_re, last_im = load_pair(own.products, n_sensors + 2 * n_phases)
    kick_re = kick_im = splat(0.0)  # v[1]
    for i in range(n_phases):
        at, first = 2 * (r * n_phases + i), read_number(own.first, i)
        kick_re = kick_re + first * read_lanes(own.ahead, at)
        kick_im = kick_im + first * read_lanes(own.ahead, at + 1)
    for i in range(n_inputs):
        at, second = 2 * (r * n_inputs + i), read_number(own.second, i)
        kick_re = kick_re + second * read_lanes(own.now, at)
        kick_im = kick_im + second * read_lanes(own.now, at + 1)
    for i in range(n_phases):
        q_re, q_im = load_pair(own.products, n_sensors + 2 * i)
        final = read_number(own.final, i)
        u_re, u_im = product(q_re - last_re * final, q_im - last_im * final, e_re, e_im)
        for k in range(n_phases):
            early = 0.5 * read_number(own.early, i * n_phases + k)
            ahead_re, ahead_im = load_pair(own.ahead, 2 * (r * n_phases + k))
            u_re, u_im = u_re + early * ahead_re, u_im + early * ahead_im
        store_pair(own.before, 2 * (r * n_phases + i), u_re, u_im)
    for i in range(n_inputs):
        passed = read_lanes(own.products, n_sensors + 2 * (own.own + i * own.own_step))
        for j in range(n_sensors):
            share = read_lanes(own.feed, j * n_inputs + i) * read_lanes(own.shapes, r * n_sensors + j)
            write_lanes(own.squares, j, read_lanes(own.squares, j) + 4.0 * share * passed)
        q_re, q_im = load_pair(own.products, n_sensors + 2 * i * stride)
        kick = read_number(own.kick, i)
        q_re, q_im = q_re + kick * kick_re, q_im + kick * kick_im
        for k in range(n_inputs):
            late = 0.5 * read_number(own.late, i * n_inputs + k)
            two_re, two_im = load_pair(own.now, 2 * (r * n_inputs + k))
            q_re, q_im = q_re - late * two_re, q_im - late * two_im
        store_pair(own.here, 2 * (r * n_inputs + i), q_re, q_im)
    store_pair(own.last, 2 * r, *product(last_re, last_im, e_re, e_im))
    for j in range(n_sensors):
        shape = read_lanes(own.shapes, r * n_sensors + j)
        write_lanes(own.cross, j, read_lanes(own.cross, j) + shape * read_lanes(own.products, j))
        write_lanes(own.ends, j, read_lanes(own.ends, j) + shape * (2.0 * last_re))


@jit
def begin(own):
    """Write what the data and the feed-through give by themselves."""
    n_sensors, n_inputs = own.n_sensors, own.n_inputs
    for j in range(n_sensors):
        square = read_number(own.data_squares, j)
        total, spread = splat(square), splat(np.sqrt(square))
        for i in range(n_inputs):
            share = read_lanes(own.feed, j * n_inputs + i)
            total = total - 2.0 * read_number(own.data_products, j * n_inputs + i) * share
            spread = spread + np.sqrt(read_number(own.inputs, i * n_inputs + i)) * magnitude(share)
            for k in range(n_inputs):
                total = total + read_number(own.inputs, i * n_inputs + k) * (
                    share * read_lanes(own.feed, j * n_inputs + k)
                )
        write_lanes(own.squares, j, total)
        write_lanes(own.spread, j, spread)
        write_lanes(own.cross, j, splat(0.0))
        write_lanes(own.ends, j, splat(0.0))


@jit
def evaluate(mesh: Mesh, sums: Sums, systems: Systems, poles: Poles, result, sizes, ends):
    """Write sums of squared misfits, what their rounding errors are relative to, and last outputs, (p, s).

    Rows of structures that the mesh does not serve stay as they are. The last outputs are those of the modes
    without the feed-through.
    """
    n_sensors, n_inputs = sums.products.shape
    n_poles = poles.numbers.shape[1]
    work = new_work(n_poles, n_sensors, (n_inputs, sums.first.size), mesh.lag_zero.shape[0] // n_inputs)
    reach, served = addresses(mesh, sums, work), np.flatnonzero(poles.served)
    entries = np.empty(poles.rows.shape, dtype=np.int64)
    write_entries(poles, mesh, reach.node, entries)
    for first in range(0, served.size, LANES):
        own = served[first : first + LANES]
        for lane in range(LANES):
            fill_lane(work, lane, systems, poles, own[min(lane, own.size - 1)])
        begin(reach)
        for r in range(n_poles):
            prepare_pole(reach, r)
            for lane in range(own.size):
                take_functions(reach, r, lane, entries[own[lane], r])
            finish_pole(reach, r)
        combine(reach, n_poles)
        for lane in range(own.size):
            for j in range(n_sensors):
                result[own[lane], j] = work.squares[j, lane] - 2.0 * work.cross[j, lane]
                sizes[own[lane], j] = work.spread[j, lane] ** 2
                ends[own[lane], j] = work.ends[j, lane]
