"""Pairs of complex modes on their way through a record, with the sums that their gradients need.

One structure in each vector lane. A number a + b i with i^2 = -1, or +1 where both poles of the pair are
real, stands for both modes of a pair, see `eigen.complex_modes`; what is summed over both is twice its real
part.

A mode carries f[k+1] = E f[k] + B0 a[k] + B1 a[k+1], E = exp(lambda h), the exact solution of
f' = lambda f + a for an input linear over the step h, and its derivative by lambda. With y = f - B1 a and
that derivative h V,

    y[k+1] = E y[k] + C a[k],   V[k+1] = E (V[k] + y[k]) + C' a[k],   C = E B1 + B0,   C' h = dC/dlambda.

All coefficients are functions of z = lambda h that are a + b z, with a and b those of the pair
(`filters.hold_functions`).
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import load, splat, store, where_less
from pymc_features.simulators.compiled.vector_memory import read_number
from pymc_features.simulators.derivatives.filters import hold_functions
from pymc_features.simulators.derivatives.pair_memory import put_number
from pymc_features.simulators.eigen.complex_modes import mode_places, pole_of
from pymc_features.simulators.eigen.pair_numbers import times
from pymc_features.simulators.eigen.residues import add_to_sums, at_sensor, input_factor, norm
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    RELATIVE_VELOCITY,
)
from pymc_features.simulators.oscillators.blocks import march_block
from pymc_features.simulators.oscillators.lanes import N_OF_PAIR, SAMPLES
from pymc_features.simulators.oscillators.places import (
    block_of,
    copy_block,
    has_own_data,
    has_own_ground,
    places_of,
    source_of,
)


@jit
def order_of(quantity):
    """How many times the displacement is differentiated."""
    if quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION):
        return 2
    return 1 if quantity == RELATIVE_VELOCITY else 0


@jit
def write_pair(lanes, pairs, modes, r, p, request):
    """Write pair r, mode p of the panel, into `Lanes` and `PairLanes`.

    `request` has the step [s], the quantity, the number of sensors and the first sample of the input.
    """
    (step, quantity, n_sensors, start), at = request, mode_places(modes)
    (a, b), square = pole_of(at, p)
    m, is_good, zero = modes.omega.shape[0], load(modes.is_good, 0), splat(0.0)
    a, b = where_less(zero, is_good, a, zero), where_less(zero, is_good, b, zero)
    store(pairs.poles, 3 * r, a)
    store(pairs.poles, 3 * r + 1, b)
    store(pairs.poles, 3 * r + 2, square)
    put_number(pairs.left, r, norm(at, p))
    factor = input_factor(at, p)
    put_number(pairs.right, r, factor)
    after = write_step(lanes, pairs, r, (a, b, square), step)
    store(lanes.states, 2 * r, 0.0 - after[0] * start)
    store(lanes.states, 2 * r + 1, 0.0 - after[1] * start)
    store(pairs.before, 4 * r + 2, 0.0 - load(pairs.slopes, 4 * r + 2) * start)
    store(pairs.before, 4 * r + 3, 0.0 - load(pairs.slopes, 4 * r + 3) * start)
    even_modes = lanes.states.shape[0] // 2
    for j in range(n_sensors):
        seen = at_sensor(at, j, p)
        residue = times(seen, factor, square)
        add_to_sums(at, j, (a, b, square), residue)
        put_number(pairs.seen, j * m + r, seen)
        for _ in range(order_of(quantity)):
            residue = times((a, b), residue, square)
        real, imaginary = -2.0 * residue[0], -2.0 * (square * residue[1])
        row = 2 * (j * even_modes + r)
        store(lanes.shapes, row, real)
        store(lanes.shapes, row + 1, imaginary)
        store(lanes.feed, j, load(lanes.feed, j) + real * after[0] + imaginary * after[1])


@jit
def at_pole(f, g, z, square):
    """f + g z, a number."""
    return f + g * z[0], g * z[1]


@jit
def slope_at_pole(f, g, z, s):
    """Derivative of f + g z by z; f and g depend on its product s with its partner and on d, less their sum.

    `f` and `g` are (value, derivative by s, derivative by d).
    """
    real = g[0] + z[0] * f[1] - f[2] + s * g[1] - g[2] * z[0]
    return real, 0.0 - (z[1] * f[1] + g[2] * z[1])


@jit
def write_step(lanes, pairs, r, pole, step):
    """Write E, C and C' of a pair, and B1 and its derivative; returns B1."""
    a, b, square = pole
    z = a * step, b * step
    s = z[0] * z[0] - square * (z[1] * z[1])
    zero, one = splat(0.0), splat(1.0)
    a0, b0, a1, b1, a2, b2 = hold_functions((s, one, zero), (-2.0 * z[0], zero, one))
    e = at_pole(a0[0], b0[0], z, square)
    phi_1, phi_2 = at_pole(a1[0], b1[0], z, square), at_pole(a2[0], b2[0], z, square)
    d_1, d_2 = slope_at_pole(a1, b1, z, s), slope_at_pole(a2, b2, z, s)
    carried = times(e, phi_2, square)
    now = step * (carried[0] + phi_1[0] - phi_2[0]), step * (carried[1] + phi_1[1] - phi_2[1])
    carried = times(e, (phi_2[0] + d_2[0], phi_2[1] + d_2[1]), square)
    row = N_OF_PAIR * r
    store(lanes.coefficients, row, e[0])
    store(lanes.coefficients, row + 1, square * e[1])
    store(lanes.coefficients, row + 2, now[0])
    store(lanes.coefficients, row + 3, e[1])
    store(lanes.coefficients, row + 4, e[0])
    store(lanes.coefficients, row + 5, now[1])
    store(pairs.slopes, 4 * r, step * (carried[0] + d_1[0] - d_2[0]))
    store(pairs.slopes, 4 * r + 1, step * (carried[1] + d_1[1] - d_2[1]))
    store(pairs.slopes, 4 * r + 2, step * d_2[0])
    store(pairs.slopes, 4 * r + 3, step * d_2[1])
    put_number(pairs.after, r, (step * phi_2[0], step * phi_2[1]))
    return step * phi_2[0], step * phi_2[1]


@jit
def carry_mode(lanes, pairs, r, block):
    """Write y and V of mode r at the samples of a block, and carry V on."""
    row, k = N_OF_PAIR * r, 4 * r
    e, f, c = (
        load(lanes.coefficients, row),
        load(lanes.coefficients, row + 1),
        load(lanes.coefficients, row + 2),
    )
    g, d = load(lanes.coefficients, row + 3), load(lanes.coefficients, row + 5)
    slope, slope_i = load(pairs.slopes, k), load(pairs.slopes, k + 1)
    y, y_i = load(pairs.before, k), load(pairs.before, k + 1)
    v, v_i = load(pairs.before, k + 2), load(pairs.before, k + 3)
    for sample in range(SAMPLES):
        store(pairs.history, 4 * sample, y)
        store(pairs.history, 4 * sample + 1, y_i)
        store(pairs.history, 4 * sample + 2, v)
        store(pairs.history, 4 * sample + 3, v_i)
        for step in range(sample * block.stride, (sample + 1) * block.stride):
            a = splat(read_number(block.ground, step))
            v, v_i = v + y, v_i + y_i
            v, v_i = e * v + (f * v_i + slope * a), g * v + (e * v_i + slope_i * a)
            y, y_i = e * y + (f * y_i + c * a), g * y + (e * y_i + d * a)
    store(pairs.before, k + 2, v)
    store(pairs.before, k + 3, v_i)


@jit
def sum_mode(pairs, r, misfits):
    """Add the sums of dL/dy times y and V of mode r in a block, two sensors at a time."""
    m = pairs.poles.shape[0] // 3
    for j in range(0, pairs.factors.shape[0], 2):
        row, other = 4 * (j * m + r), 4 * ((j + 1) * m + r)
        a0, a1, a2, a3 = (
            load(pairs.sums, row),
            load(pairs.sums, row + 1),
            load(pairs.sums, row + 2),
            load(pairs.sums, row + 3),
        )
        b0, b1, b2, b3 = (
            load(pairs.sums, other),
            load(pairs.sums, other + 1),
            load(pairs.sums, other + 2),
            load(pairs.sums, other + 3),
        )
        for t in range(SAMPLES):
            u, w = load(misfits, SAMPLES * j + t), load(misfits, SAMPLES * (j + 1) + t)
            y, y_i = load(pairs.history, 4 * t), load(pairs.history, 4 * t + 1)
            v, v_i = load(pairs.history, 4 * t + 2), load(pairs.history, 4 * t + 3)
            a0, a1, a2, a3 = a0 + u * y, a1 + u * y_i, a2 + u * v, a3 + u * v_i
            b0, b1, b2, b3 = b0 + w * y, b1 + w * y_i, b2 + w * v, b3 + w * v_i
        store(pairs.sums, row, a0)
        store(pairs.sums, row + 1, a1)
        store(pairs.sums, row + 2, a2)
        store(pairs.sums, row + 3, a3)
        store(pairs.sums, other, b0)
        store(pairs.sums, other + 1, b1)
        store(pairs.sums, other + 2, b2)
        store(pairs.sums, other + 3, b3)


@jit
def weigh_misfits(lanes, pairs, observed, first, block):
    """Turn the misfits of a block into dL/dy, zero where nothing was measured; add them times the input."""
    (n_sensors, total), misfits = observed.shape, lanes.misfits
    for j in range(n_sensors):
        factor, of_ground = load(pairs.factors, j), load(pairs.of_ground, j)
        for b in range(SAMPLES):
            row = SAMPLES * j + b
            is_there = first + b < total and observed[j, first + b] == observed[j, first + b]
            weighted = factor * load(misfits, row) if is_there else splat(0.0)
            store(misfits, row, weighted)
            of_ground = of_ground + weighted * splat(read_number(block.ground, b * block.stride))
        store(pairs.of_ground, j, of_ground)
    for row in range(SAMPLES * n_sensors, misfits.shape[0]):  # the sensor that fills up an odd number
        store(misfits, row, splat(0.0))


@jit
def sum_pairs(lanes, pairs, excitation, observed):
    """Take the structures in the lanes through a record of one input (t,), compared with data (s, u)."""
    at, source, m = places_of(lanes), source_of(lanes, excitation, observed), pairs.poles.shape[0] // 3
    pairs.sums.fill(0.0)
    pairs.of_ground.fill(0.0)
    for first in range(0, observed.shape[1], SAMPLES):
        if has_own_ground(source, first) or has_own_data(source, first):
            copy_block(lanes, source, excitation, observed, first)
        block = block_of(source, first)
        for r in range(m):
            store(pairs.before, 4 * r, load(lanes.states, 2 * r))
            store(pairs.before, 4 * r + 1, load(lanes.states, 2 * r + 1))
        march_block(at, block, True)
        weigh_misfits(lanes, pairs, observed, first, block)
        for r in range(m):
            carry_mode(lanes, pairs, r, block)
            sum_mode(pairs, r, lanes.misfits)
