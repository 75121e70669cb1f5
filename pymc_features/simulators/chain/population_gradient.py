"""Gradients of the misfits of many chains at once, a vector of them at a time."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.chain.gradient import add_gradient, relative_feed, spread_gradient, zeros_like
from pymc_features.simulators.chain.parameters import own_rows
from pymc_features.simulators.chain.population import check_population, new_modes, solve_modes
from pymc_features.simulators.chain.population_modes import take_modes
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import read_lanes, write_lanes
from pymc_features.simulators.derivatives.history import read_four, sum_history, write_four
from pymc_features.simulators.derivatives.memory import (
    VECTOR,
    clear,
    first_vector,
    get,
    new_gradient_lanes,
    put,
    room_of_lanes,
)
from pymc_features.simulators.derivatives.pairs import (
    derive_modes,
    derive_pairs,
    modes_apart,
    take_gradient,
    take_sums,
)
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    seen_data,
)
from pymc_features.simulators.oscillators.fast_modes import highest_step, is_fast
from pymc_features.simulators.oscillators.recursion import write_damping


class ChainLanes(NamedTuple):
    """Addresses of what chains, one in each lane, have beside `GradientLanes`.

    Attributes
    ----------
    n, padded : int
        Number of masses, and rounded up to a multiple of four.
    rows : (n padded) vectors
        Mode shapes, entry i of mode r at r padded + i; then drifts, once the derivatives by masses are there.
    by_mass, by_stiffness, omega : (padded) vectors
        Derivatives of L; frequencies of all modes.
    apart : one vector
        Of `modes_apart`.
    """

    n: int
    padded: int
    rows: int
    by_mass: int
    by_stiffness: int
    omega: int
    apart: int


@jit
def room_of_chains(n):
    """Memory for `new_chain_lanes`, zeros."""
    return np.zeros(((n + 3) * (n + 3) + 2) * LANES)


@jit
def new_chain_lanes(room, n):
    """Lanes of chains in a memory from `room_of_chains`, which the caller keeps."""
    rows, padded = first_vector(room), (n + 3) // 4 * 4
    block = VECTOR * padded
    by_mass = rows + n * block
    return ChainLanes(n, padded, rows, by_mass, by_mass + block, by_mass + 2 * block, by_mass + 3 * block)


@jit
def write_forms(matrix, stride, chains, forms):
    """Write x_i' A x_i (n,) of symmetric A, entry r, s at `r * stride + s`; x_i is entry i of all modes."""
    n, padded, rows = chains.n, chains.padded, chains.rows
    for i in range(0, padded, 4):
        f0 = f1 = f2 = f3 = splat(0.0)
        for r in range(n):
            s0 = s1 = s2 = s3 = splat(0.0)
            for s in range(r):
                entry = read_lanes(matrix, r * stride + s)
                x0, x1, x2, x3 = read_four(rows, s * padded + i, 1)
                s0, s1, s2, s3 = s0 + entry * x0, s1 + entry * x1, s2 + entry * x2, s3 + entry * x3
            entry = read_lanes(matrix, r * stride + r)
            x0, x1, x2, x3 = read_four(rows, r * padded + i, 1)
            f0, f1 = f0 + x0 * (entry * x0 + 2.0 * s0), f1 + x1 * (entry * x1 + 2.0 * s1)
            f2, f3 = f2 + x2 * (entry * x2 + 2.0 * s2), f3 + x3 * (entry * x3 + 2.0 * s3)
        write_four(forms, i, f0, f1, f2, f3)


@jit
def fill_lane(lanes, lane, own, wanted, omega, damping, participation, rows):
    """Write the modes of one chain into a lane."""
    for r in range(lanes.n_modes):
        put(lanes.omega, r, lane, omega[r])
        put(lanes.damping, r, lane, damping[r])
        put(lanes.slopes, r, lane, own.rayleigh[1] + own.ratios[r] / omega[r])
        put(lanes.ratios, r, lane, own.ratios[r])
        put(lanes.participation, r, lane, participation[r])
        for j in range(lanes.n_sensors):
            put(lanes.shapes, j * lanes.m + r, lane, rows[r, wanted.sensors[j]])


@jit
def fill_lanes(lanes, chains, modes, parameters, wanted, steps, first):
    """Write the chains from particle `first` on into the lanes, their modes in ascending order.

    `steps` as in `take_lane`.
    """
    step, highest = steps
    n, m = chains.n, wanted.n_modes
    omega, participation, rows, damping = np.empty(n), np.empty(n), np.empty((n, n)), np.empty(m)
    for lane in range(LANES):
        clear(lanes, lane)
        if not modes.valid[lane]:
            continue
        own = own_rows(parameters, first + lane)
        take_modes(modes, lane, omega, participation, rows)
        modes.valid[lane] = write_damping(omega[:m], own.rayleigh, own.ratios, step, damping)
        for r in range(m):
            modes.valid[lane] &= not is_fast(omega[r] * step, damping[r] * step, highest)
        if modes.valid[lane]:
            fill_lane(lanes, lane, own, wanted, omega, damping, participation, rows)
            for r in range(n):
                put(chains.omega, r, lane, omega[r])
                for i in range(n):
                    put(chains.rows, r * chains.padded + i, lane, rows[r, i])


@jit
def spread_lanes(lanes, chains):
    """Write the derivatives by masses and springs where all modes are kept; drifts replace the shapes."""
    n, padded = chains.n, chains.padded
    write_forms(lanes.by_mass, lanes.m, chains, chains.by_mass)
    for i in range(n):
        total = read_lanes(chains.by_mass, i)
        for r in range(n):
            total = total + read_lanes(chains.rows, r * padded + i) * read_lanes(lanes.by_load, r)
        write_lanes(chains.by_mass, i, total)
    for r in range(n):
        for i in range(r * padded + n - 1, r * padded, -1):
            write_lanes(chains.rows, i, read_lanes(chains.rows, i) - read_lanes(chains.rows, i - 1))
    write_forms(lanes.by_stiffness, lanes.m, chains, chains.by_stiffness)


@jit
def add_lane(lanes, chains, lane, own, wanted, gradients):
    """Add the derivatives of one lane to the gradients of its chain."""
    n = chains.n
    if wanted.n_modes < n:
        omega, rows = np.empty(n), np.empty((n, n))
        for r in range(n):
            omega[r] = get(chains.omega, r, lane)
            for i in range(n):
                rows[r, i] = get(chains.rows, r * chains.padded + i, lane)
        spread_gradient(own, wanted, omega, rows, take_gradient(lanes, lane), gradients)
        return
    for i in range(n):
        gradients.mass[i] += get(chains.by_mass, i, lane)
        gradients.stiffness[i] += get(chains.by_stiffness, i, lane)
    for r in range(n):
        damping, omega = get(lanes.by_damping, r, lane), get(lanes.omega, r, lane)
        gradients.rayleigh[0] += damping
        gradients.rayleigh[1] += damping * omega * omega
        gradients.ratios[r] += damping * 2.0 * omega


@jit
def add_groups(rooms, parameters, excitation, wanted, observed, weights, gradients):
    """Add the gradients by e_j alone, weights (p, s, 1), of a vector of chains at a time.

    A chain with modes that are close goes by itself, `add_gradient`. `rooms` are two memories.
    """
    n, n_sensors, start = parameters.mass.shape[1], wanted.sensors.size, excitation.acceleration[0]
    step, n_times = excitation.dt / excitation.substeps, observed.shape[1]
    seen = observed
    if wanted.quantity == RELATIVE_ACCELERATION:
        seen = seen_data(excitation, observed, np.ones(n_sensors))
    feed, modes = relative_feed(wanted)[:, 0].copy(), new_modes(n)
    lanes = new_gradient_lanes(rooms[0], feed, wanted.n_modes, excitation.stride)
    chains = new_chain_lanes(rooms[1], n)
    for first in range(0, weights.shape[0], LANES):
        count = min(LANES, weights.shape[0] - first)
        solve_modes(modes, parameters, first, count)
        fill_lanes(lanes, chains, modes, parameters, wanted, (step, highest_step(excitation)), first)
        for lane in range(count):
            for j in range(n_sensors):
                put(lanes.factors, j, lane, 2.0 * weights[first + lane, j, 0] / n_times)
        write_lanes(chains.apart, 0, modes_apart(lanes, n_times * excitation.stride * step))
        sum_history(lanes, rooms[0], excitation, wanted.quantity, seen)
        derive_modes(lanes, step, start)
        derive_pairs(lanes)
        if wanted.n_modes == n:
            spread_lanes(lanes, chains)
        for lane in range(count):
            own, own_gradients = own_rows(parameters, first + lane), own_rows(gradients, first + lane)
            if modes.valid[lane] and get(chains.apart, 0, lane) == 1.0:
                add_lane(lanes, chains, lane, own, wanted, own_gradients)
            else:
                add_gradient(own, excitation, wanted, observed, weights[first + lane], own_gradients)


@jit
def population_gradient(parameters, excitation, wanted, observed, weights):
    """Gradient of sum_pjq weights_pjq statistics_pjq of a population; what all particles share gets the sum.

    Parameters as in `population.population_misfit`, and `weights` (p, s, 1) or (p, s, 4). Returns arrays of
    the shapes of the parameters.
    """
    gradients, n = zeros_like(parameters), parameters.mass.shape[1]
    is_acceleration = wanted.quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION)
    is_known = excitation.direct.size == 0 or wanted.n_modes == n or not is_acceleration
    if weights.shape[2] == 1 and weights.shape[0] > 2 and is_known:
        check_population(parameters, excitation, wanted, observed)
        rooms = room_of_lanes(wanted.sensors.size, wanted.n_modes, excitation.stride), room_of_chains(n)
        add_groups(rooms, parameters, excitation, wanted, observed, weights, gradients)
        return gradients
    for p in range(weights.shape[0]):
        own, own_gradients = own_rows(parameters, p), own_rows(gradients, p)
        add_gradient(own, excitation, wanted, observed, weights[p], own_gradients)
    return gradients


@jit
def spread_groups(rooms, parameters, excitation, wanted, sums, gradients):
    """Add the gradients of a vector of chains at a time, from sums over time; `rooms` as in `add_groups`."""
    (n_particles, n_sensors, m), n = sums[0].shape, parameters.mass.shape[1]
    step, modes = excitation.dt / excitation.substeps, new_modes(n)
    lanes, chains = new_gradient_lanes(rooms[0], np.zeros(n_sensors), m, 1), new_chain_lanes(rooms[1], n)
    for first in range(0, n_particles, LANES):
        count = min(LANES, n_particles - first)
        solve_modes(modes, parameters, first, count)
        fill_lanes(lanes, chains, modes, parameters, wanted, (step, highest_step(excitation)), first)
        take_sums(lanes, sums, first, count)
        derive_pairs(lanes)
        if m == n:
            spread_lanes(lanes, chains)
        for lane in range(count):
            own, own_gradients = own_rows(parameters, first + lane), own_rows(gradients, first + lane)
            if modes.valid[lane]:
                add_lane(lanes, chains, lane, own, wanted, own_gradients)
            else:
                for gradient in own_gradients:
                    gradient[:] = np.nan


@jit
def chain_gradient_of_sums(parameters, excitation, wanted, sums):
    """Gradients of a population of which the sums over time are known, see `take_sums`.

    No two modes of a chain may be close. Parameters and results as in `population_gradient`.
    """
    gradients, n = zeros_like(parameters), parameters.mass.shape[1]
    rooms = room_of_lanes(wanted.sensors.size, wanted.n_modes, 1), room_of_chains(n)
    spread_groups(rooms, parameters, excitation, wanted, sums, gradients)
    return gradients
