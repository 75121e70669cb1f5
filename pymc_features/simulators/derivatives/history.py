"""Sums over time that the gradient of mean squares needs, for one structure in each lane of a vector.

What `oscillators.gradient.sum_histories` sums for one structure is summed here for a vector of them, a block
of samples at a time. First the modes of a block are marched and compared with the data, which gives dL/dy of
each sensor j. Then, mode by mode, u = sum_j S_jr Gamma_r dL/dy_j is combined, and the filters of `filters.py`
go through the block once more, beside those that carry their derivatives. The sums of u times W, E, V and G,
and those of dL/dy_j times each mode's output, are all that the gradient takes from the history.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import splat
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number, write_lanes, write_number
from pymc_features.simulators.derivatives.filters import (
    BY_A,
    BY_E,
    BY_W,
    DECAY,
    KAPPA,
    SIGN,
    START_E,
    START_W,
    write_filter,
)
from pymc_features.simulators.derivatives.memory import N_FILTER, N_STATES, ground_of
from pymc_features.simulators.oscillators.arguments import interpolate
from pymc_features.simulators.oscillators.lanes import SAMPLES, has_gaps


@jit
def read_four(address, row, step):
    """Vectors `row`, `row + step`, `row + 2 step` and `row + 3 step`."""
    return (
        read_lanes(address, row),
        read_lanes(address, row + step),
        read_lanes(address, row + 2 * step),
        read_lanes(address, row + 3 * step),
    )


@jit
def write_four(address, row, a, b, c, d):
    """Write four vectors, one after the other."""
    write_lanes(address, row, a)
    write_lanes(address, row + 1, b)
    write_lanes(address, row + 2, c)
    write_lanes(address, row + 3, d)


@jit
def recursion(lanes, r):
    """sigma e^-d, kappa and sigma of a mode."""
    c, coefficients = N_FILTER * r, lanes.coefficients
    return (
        read_lanes(coefficients, c + DECAY),
        read_lanes(coefficients, c + KAPPA),
        read_lanes(coefficients, c + SIGN),
    )


@jit
def prepare(lanes, step, quantity):
    """Write the coefficients of the structures in the lanes; their states are at rest, all sums zero."""
    zero, m = splat(0.0), lanes.m
    for i in range(N_STATES * m):
        write_lanes(lanes.states, i, zero)
        write_lanes(lanes.sums, i, zero)
    for r in range(m):
        omega, damping = read_lanes(lanes.omega, r), read_lanes(lanes.damping, r)
        write_filter(omega, damping, step, quantity, lanes.coefficients, N_FILTER * r)
        write_lanes(lanes.states, N_STATES * r + 4, splat(1.0))
        write_lanes(lanes.states, N_STATES * r + 5, splat(1.0))
    for j in range(lanes.s):
        direct = splat(read_number(lanes.feed, j))
        for r in range(m):
            scaled = read_lanes(lanes.shapes, j * m + r) * read_lanes(lanes.participation, r)
            direct = direct + scaled * read_lanes(lanes.coefficients, N_FILTER * r + BY_A)
            write_lanes(lanes.scaled, j * m + r, scaled)
            write_lanes(lanes.products, j * m + r, zero)
        write_lanes(lanes.direct, j, direct)
        write_lanes(lanes.of_ground, j, zero)


@jit
def march_filters(lanes, ground):
    """Write the outputs of every mode at the steps of a block and carry W and E on; two modes together."""
    n_steps, states, outputs = SAMPLES * lanes.stride, lanes.states, lanes.outputs
    for r in range(0, lanes.m, 2):
        c, k, row = N_FILTER * r, N_STATES * r, n_steps * r
        decay_a, kappa_a, sign_a = recursion(lanes, r)
        decay_b, kappa_b, sign_b = recursion(lanes, r + 1)
        by_w_a, by_e_a = read_lanes(lanes.coefficients, c + BY_W), read_lanes(lanes.coefficients, c + BY_E)
        c += N_FILTER
        by_w_b, by_e_b = read_lanes(lanes.coefficients, c + BY_W), read_lanes(lanes.coefficients, c + BY_E)
        w_a, e_a = read_lanes(states, k), read_lanes(states, k + 1)
        w_b, e_b = read_lanes(states, k + N_STATES), read_lanes(states, k + N_STATES + 1)
        write_four(lanes.before, 2 * r, w_a, e_a, w_b, e_b)
        for i in range(n_steps):
            a = splat(read_number(ground, i))
            write_lanes(outputs, row + i, by_w_a * w_a + by_e_a * e_a)
            write_lanes(outputs, row + n_steps + i, by_w_b * w_b + by_e_b * e_b)
            e_a, e_b = decay_a * e_a + (a - kappa_a * w_a), decay_b * e_b + (a - kappa_b * w_b)
            w_a, w_b = sign_a * w_a + e_a, sign_b * w_b + e_b
        write_lanes(states, k, w_a)
        write_lanes(states, k + 1, e_a)
        write_lanes(states, k + N_STATES, w_b)
        write_lanes(states, k + N_STATES + 1, e_b)


@jit
def march_start(lanes, start):
    """Take what the acceleration `start` of the first sample has too much from the outputs of a block."""
    n_steps, outputs = SAMPLES * lanes.stride, lanes.outputs
    for r in range(lanes.m):
        c, k, row = N_FILTER * r, N_STATES * r, n_steps * r
        decay, kappa, sign = recursion(lanes, r)
        by_w = start * read_lanes(lanes.coefficients, c + START_W)
        by_e = start * read_lanes(lanes.coefficients, c + START_E)
        w, e = read_lanes(lanes.states, k + 4), read_lanes(lanes.states, k + 5)
        for i in range(n_steps):
            write_lanes(outputs, row + i, read_lanes(outputs, row + i) - (by_w * w + by_e * e))
            e = decay * e - kappa * w
            w = sign * w + e


@jit
def weigh(lanes, data, length, ground, with_gaps):
    """Write dL/dy of all sensors in a block: `factors` times response less data; zero in gaps.

    `data` is the address of the block's first sample of the first sensor, `length` samples before that of
    the next.
    """
    stride, m, last = lanes.stride, lanes.m, lanes.n_sensors - 1
    for j in range(0, lanes.s, 2):
        k = min(j + 1, last)  # an odd number of sensors is filled up with one of no consequence
        direct_a, direct_b = read_lanes(lanes.direct, j), read_lanes(lanes.direct, j + 1)
        factor_a, factor_b = read_lanes(lanes.factors, j), read_lanes(lanes.factors, j + 1)
        sum_a, sum_b = read_lanes(lanes.of_ground, j), read_lanes(lanes.of_ground, j + 1)
        for t in range(0, SAMPLES, 4):
            g0, g1 = read_number(ground, t * stride), read_number(ground, (t + 1) * stride)
            g2, g3 = read_number(ground, (t + 2) * stride), read_number(ground, (t + 3) * stride)
            i, h = j * length + t, k * length + t
            a0, a1 = direct_a * g0 - read_number(data, i), direct_a * g1 - read_number(data, i + 1)
            a2, a3 = direct_a * g2 - read_number(data, i + 2), direct_a * g3 - read_number(data, i + 3)
            b0, b1 = direct_b * g0 - read_number(data, h), direct_b * g1 - read_number(data, h + 1)
            b2, b3 = direct_b * g2 - read_number(data, h + 2), direct_b * g3 - read_number(data, h + 3)
            row_a, row_b = j * m, (j + 1) * m
            for r in range(m):
                shape_a, shape_b = read_lanes(lanes.scaled, row_a + r), read_lanes(lanes.scaled, row_b + r)
                z0, z1, z2, z3 = read_four(lanes.outputs, (SAMPLES * r + t) * stride, stride)
                a0, b0 = a0 + shape_a * z0, b0 + shape_b * z0
                a1, b1 = a1 + shape_a * z1, b1 + shape_b * z1
                a2, b2 = a2 + shape_a * z2, b2 + shape_b * z2
                a3, b3 = a3 + shape_a * z3, b3 + shape_b * z3
            a0, a1, a2, a3 = factor_a * a0, factor_a * a1, factor_a * a2, factor_a * a3
            b0, b1, b2, b3 = factor_b * b0, factor_b * b1, factor_b * b2, factor_b * b3
            if with_gaps:
                measured, i, h = lanes.measured, SAMPLES * j + t, SAMPLES * k + t
                a0, a1 = read_number(measured, i) * a0, read_number(measured, i + 1) * a1
                a2, a3 = read_number(measured, i + 2) * a2, read_number(measured, i + 3) * a3
                b0, b1 = read_number(measured, h) * b0, read_number(measured, h + 1) * b1
                b2, b3 = read_number(measured, h + 2) * b2, read_number(measured, h + 3) * b3
            sum_a = sum_a + ((a0 * g0 + a1 * g1) + (a2 * g2 + a3 * g3))
            sum_b = sum_b + ((b0 * g0 + b1 * g1) + (b2 * g2 + b3 * g3))
            write_four(lanes.weighted, SAMPLES * j + t, a0, a1, a2, a3)
            write_four(lanes.weighted, SAMPLES * (j + 1) + t, b0, b1, b2, b3)
        write_lanes(lanes.of_ground, j, sum_a)
        write_lanes(lanes.of_ground, j + 1, sum_b)


@jit
def turn_weights(lanes):
    """Write u of every mode into `turned`; add dL/dy_j times the modes' outputs to `products`."""
    stride, m, products = lanes.stride, lanes.m, lanes.products
    for r in range(lanes.n_modes):
        for t in range(0, SAMPLES, 8):
            z0, z1, z2, z3 = read_four(lanes.outputs, (SAMPLES * r + t) * stride, stride)
            z4, z5, z6, z7 = read_four(lanes.outputs, (SAMPLES * r + t + 4) * stride, stride)
            u0 = u1 = u2 = u3 = u4 = u5 = u6 = u7 = splat(0.0)
            for j in range(lanes.n_sensors):
                row = j * m + r
                shape = read_lanes(lanes.scaled, row)
                w0, w1, w2, w3 = read_four(lanes.weighted, SAMPLES * j + t, 1)
                w4, w5, w6, w7 = read_four(lanes.weighted, SAMPLES * j + t + 4, 1)
                u0, u1, u2, u3 = u0 + shape * w0, u1 + shape * w1, u2 + shape * w2, u3 + shape * w3
                u4, u5, u6, u7 = u4 + shape * w4, u5 + shape * w5, u6 + shape * w6, u7 + shape * w7
                even = (z0 * w0 + z2 * w2) + (z4 * w4 + z6 * w6)
                odd = (z1 * w1 + z3 * w3) + (z5 * w5 + z7 * w7)
                write_lanes(products, row, read_lanes(products, row) + (even + odd))
            write_four(lanes.turned, SAMPLES * r + t, u0, u1, u2, u3)
            write_four(lanes.turned, SAMPLES * r + t + 4, u4, u5, u6, u7)


@jit
def sum_filters(lanes, ground):
    """Add the sums of u times W, E, V and G of every mode, and carry V and G on."""
    stride, states = lanes.stride, lanes.states
    for r in range(lanes.n_modes):
        k, row = N_STATES * r, SAMPLES * stride * r
        decay, kappa, sign = recursion(lanes, r)
        w, e = read_lanes(lanes.before, 2 * r), read_lanes(lanes.before, 2 * r + 1)
        v, g = read_lanes(states, k + 2), read_lanes(states, k + 3)
        sum_w, sum_e, sum_v, sum_g = read_four(lanes.sums, k, 1)
        for sample in range(SAMPLES):
            u = read_lanes(lanes.turned, SAMPLES * r + sample)
            sum_w, sum_e, sum_v, sum_g = sum_w + u * w, sum_e + u * e, sum_v + u * v, sum_g + u * g
            for i in range(sample * stride, (sample + 1) * stride):
                e = decay * e + (splat(read_number(ground, i)) - kappa * w)
                g = decay * g + (read_lanes(lanes.outputs, row + i) - kappa * v)
                w, v = sign * w + e, sign * v + g
        write_lanes(states, k + 2, v)
        write_lanes(states, k + 3, g)
        write_four(lanes.sums, k, sum_w, sum_e, sum_v, sum_g)


@jit
def sum_start(lanes):
    """As `sum_filters`, of W and E of the start, which are carried on."""
    states, sums = lanes.states, lanes.sums
    for r in range(lanes.n_modes):
        k = N_STATES * r
        decay, kappa, sign = recursion(lanes, r)
        w, e = read_lanes(states, k + 4), read_lanes(states, k + 5)
        sum_w, sum_e = read_lanes(sums, k + 4), read_lanes(sums, k + 5)
        for sample in range(SAMPLES):
            u = read_lanes(lanes.turned, SAMPLES * r + sample)
            sum_w, sum_e = sum_w + u * w, sum_e + u * e
            for _ in range(lanes.stride):
                e = decay * e - kappa * w
                w = sign * w + e
        write_lanes(states, k + 4, w)
        write_lanes(states, k + 5, e)
        write_lanes(sums, k + 4, sum_w)
        write_lanes(sums, k + 5, sum_e)


@jit
def copy_data(lanes, observed, first):
    """Write a block of data, from sample `first` on, and where there are data, into the lanes' memory."""
    for j in range(observed.shape[0]):
        for b in range(SAMPLES):
            value = observed[j, first + b] if first + b < observed.shape[1] else np.nan
            is_there = value == value
            write_number(lanes.measured, SAMPLES * j + b, 1.0 if is_there else 0.0)
            write_number(lanes.data, SAMPLES * j + b, value if is_there else 0.0)


@jit
def sum_history(lanes, room, excitation, quantity, observed):
    """Take the structures in the lanes through a record of one input (t,), compared with data (s, u)."""
    acceleration, dt, substeps, stride, _ = excitation
    n_sensors, n_times = observed.shape
    start, own_ground, gaps = acceleration[0], ground_of(lanes, room), has_gaps(observed)
    prepare(lanes, dt / substeps, quantity)
    for first in range(0, n_times, SAMPLES):
        step = first * stride
        ground, data, length = acceleration.ctypes.data + 8 * step, observed.ctypes.data + 8 * first, n_times
        if substeps > 1 or step + SAMPLES * stride > acceleration.size:
            interpolate(acceleration, substeps, step, own_ground)
            ground = lanes.ground
        masked = gaps or first + SAMPLES > n_times
        if masked:
            copy_data(lanes, observed, first)
            data, length = lanes.data, SAMPLES
        march_filters(lanes, ground)
        if start != 0.0:
            march_start(lanes, start)
        weigh(lanes, data, length, ground, masked)
        turn_weights(lanes)
        sum_filters(lanes, ground)
        if start != 0.0:
            sum_start(lanes)
