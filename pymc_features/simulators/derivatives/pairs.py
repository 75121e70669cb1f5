"""Derivatives by the reduced matrices of structures in lanes: `gradient.reduce_sums` for a vector of them."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat, where_less
from pymc_features.simulators.compiled.vector_math import larger
from pymc_features.simulators.compiled.vector_memory import read_lanes, write_lanes
from pymc_features.simulators.derivatives.filters import BY_A, BY_D, BY_S, DECAY
from pymc_features.simulators.derivatives.memory import N_FILTER, N_STATES, get, put
from pymc_features.simulators.oscillators.close_modes import CLOSE
from pymc_features.simulators.oscillators.gradient import ModalGradient


@jit
def modes_apart(lanes, duration):
    """One in the lanes where no two modes are close as in `close_modes`; zero in some others, too.

    The modes lie in ascending order: where two are close, so are all between them.
    """
    one = splat(1.0)
    apart = one
    for r in range(1, lanes.n_modes):
        omega, below = read_lanes(lanes.omega, r), read_lanes(lanes.omega, r - 1)
        decay, gap = 0.5 * read_lanes(lanes.damping, r), omega - below
        memory = where_less(one, duration * decay, one / decay, splat(duration))
        difference = gap * larger(memory, 3.0 / omega)
        growth = gap * (omega + below) * duration * larger(splat(duration), read_lanes(lanes.slopes, r))
        growth = where_less(splat(0.0), read_lanes(lanes.ratios, r), difference, growth)
        difference = where_less(growth, difference, growth, difference)
        apart = where_less(splat(CLOSE), difference, apart, splat(0.0))
    return apart


@jit
def by_coefficients(lanes, r, first, of_ground, start):
    """Derivative of L by s or d of mode r, whose derivatives of the coefficients begin at row `first`."""
    c, k, coefficients, sums = N_FILTER * r + first, N_STATES * r, lanes.coefficients, lanes.sums
    total = read_lanes(coefficients, c + 3) * of_ground
    total = total - read_lanes(coefficients, c) * read_lanes(sums, k + 2)
    total = total + read_lanes(coefficients, c + 1) * read_lanes(sums, k)
    total = total + read_lanes(coefficients, c + 2) * read_lanes(sums, k + 1)
    if start != 0.0:
        own = read_lanes(coefficients, c + 4) * read_lanes(sums, k + 4)
        total = total - start * (own + read_lanes(coefficients, c + 5) * read_lanes(sums, k + 5))
    return total


@jit
def derive_modes(lanes, step, start):
    """Write dL/dlambda, dL/dD, dL/d(Phi' L) and dL/d(S Phi); complete the sums over outputs."""
    m = lanes.m
    for r in range(lanes.n_modes):
        c, k, gamma = N_FILTER * r, N_STATES * r, read_lanes(lanes.participation, r)
        of_ground = load = splat(0.0)
        for j in range(lanes.n_sensors):
            ground, row = read_lanes(lanes.of_ground, j), j * m + r
            of_ground = of_ground + read_lanes(lanes.scaled, row) * ground
            product = read_lanes(lanes.products, row) + read_lanes(lanes.coefficients, c + BY_A) * ground
            load = load + read_lanes(lanes.shapes, row) * product
            write_lanes(lanes.by_shapes, row, gamma * product)
        by_s = by_coefficients(lanes, r, BY_S, of_ground, start)
        by_d = by_coefficients(lanes, r, BY_D, of_ground, start)
        by_d = by_d - read_lanes(lanes.coefficients, c + DECAY) * read_lanes(lanes.sums, k + 3)
        write_lanes(lanes.by_lambda, r, step * step * by_s + step * (read_lanes(lanes.slopes, r) * by_d))
        write_lanes(lanes.by_damping, r, step * by_d)
        write_lanes(lanes.by_load, r, load)


@jit
def take_sums(lanes, sums, first, count):
    """Write dL/dlambda, dL/dD, dL/d(Phi' L) and dL/d(S Phi) of structures `first` ... from sums over time.

    `sums` are those of dL/dy_j times modal outputs (p, s, m), relative to the ground in accelerations, and
    dL/dlambda at the same D and shapes and dL/dD, both (p, m).
    """
    (outputs, by_lambda, by_damping), m = sums, lanes.m
    for lane in range(LANES):
        p = first + min(lane, count - 1)
        for r in range(lanes.n_modes):
            put(lanes.by_damping, r, lane, by_damping[p, r])
            put(lanes.by_lambda, r, lane, by_lambda[p, r])
            for j in range(lanes.n_sensors):
                put(lanes.by_shapes, j * m + r, lane, outputs[p, j, r])
    for r in range(lanes.n_modes):
        gamma, load = read_lanes(lanes.participation, r), splat(0.0)
        for j in range(lanes.n_sensors):
            product = read_lanes(lanes.by_shapes, j * m + r)
            load = load + read_lanes(lanes.shapes, j * m + r) * product
            write_lanes(lanes.by_shapes, j * m + r, gamma * product)
        slope = read_lanes(lanes.slopes, r) * read_lanes(lanes.by_damping, r)
        write_lanes(lanes.by_lambda, r, read_lanes(lanes.by_lambda, r) + slope)
        write_lanes(lanes.by_load, r, load)


@jit
def derive_pairs(lanes):
    """Write the derivatives by the reduced matrices, see `GradientLanes`, from those by each mode."""
    m = lanes.m
    for r in range(lanes.n_modes):
        omega, gamma = read_lanes(lanes.omega, r), read_lanes(lanes.participation, r)
        load, own = read_lanes(lanes.by_load, r), read_lanes(lanes.by_lambda, r)
        write_lanes(lanes.by_stiffness, r * m + r, own)
        write_lanes(lanes.by_mass, r * m + r, splat(0.0) - (omega * omega * own + load * gamma))
        for s in range(r):
            other, p_rs, p_sr = read_lanes(lanes.omega, s), splat(0.0), splat(0.0)
            for j in range(lanes.n_sensors):
                row = j * m
                p_rs = p_rs + read_lanes(lanes.shapes, row + r) * read_lanes(lanes.by_shapes, row + s)
                p_sr = p_sr + read_lanes(lanes.shapes, row + s) * read_lanes(lanes.by_shapes, row + r)
            q_rs, q_sr = load * read_lanes(lanes.participation, s), read_lanes(lanes.by_load, s) * gamma
            difference = ((p_sr - q_sr) - (p_rs - q_rs)) / ((omega - other) * (omega + other))
            mean = 0.5 * (omega * omega + other * other)
            mass = splat(-0.5) * (mean * difference + 0.5 * ((p_rs + p_sr) + (q_rs + q_sr)))
            stiffness = 0.5 * difference
            write_lanes(lanes.by_stiffness, r * m + s, stiffness)
            write_lanes(lanes.by_stiffness, s * m + r, stiffness)
            write_lanes(lanes.by_mass, r * m + s, mass)
            write_lanes(lanes.by_mass, s * m + r, mass)


@jit
def take_gradient(lanes, lane):
    """The `ModalGradient` of one lane, of one input."""
    m, (n_sensors, n_modes) = lanes.m, (lanes.n_sensors, lanes.n_modes)
    stiffness, mass = np.empty((n_modes, n_modes)), np.empty((n_modes, n_modes))
    load, shapes, damping = np.empty((n_modes, 1)), np.empty((n_sensors, n_modes)), np.empty(n_modes)
    for r in range(n_modes):
        load[r, 0], damping[r] = get(lanes.by_load, r, lane), get(lanes.by_damping, r, lane)
        for s in range(n_modes):
            stiffness[r, s] = get(lanes.by_stiffness, r * m + s, lane)
            mass[r, s] = get(lanes.by_mass, r * m + s, lane)
        for j in range(n_sensors):
            shapes[j, r] = get(lanes.by_shapes, j * m + r, lane)
    return ModalGradient(stiffness, mass, load, shapes, damping)
