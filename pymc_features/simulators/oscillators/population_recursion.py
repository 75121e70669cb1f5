"""The recursion and the comparison with data for one particle in each lane of a vector register.

The recursion of `recursion.py` in coordinates made for speed. For mode r, z = (z1, z2) is the state turned
and scaled so that z1 is the mode's output, Eq. (24), and z2 its complement in energy; the turned equations
are z[k+1] = A z[k] + b0 a[k] + b1 a[k+1]. With y = z - b1 a,

    y[k+1] = A y[k] + (A b1 + b0) a[k],     output[k] = y1[k] + b1_1 a[k],

and with y2 scaled so that the coefficient by which it enters y1 is one, five products for a mode and step
instead of ten; what stands before a[k] in the output goes into the feed-through of the sensors. A block of
16 outputs of all modes stays in the first-level cache, where it is combined with the mode shapes and
compared with the data, two sensors and four samples at a time. Where the increments of the misfit are asked
for, the misfits of the block go through a buffer in that cache; where not, numba leaves that code out.
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import load, splat, store
from pymc_features.simulators.oscillators.arguments import interpolate
from pymc_features.simulators.oscillators.recursion import (
    OUT_P,
    OUT_Q,
    P_NEXT,
    P_NOW,
    P_P,
    P_Q,
    Q_NEXT,
    Q_NOW,
    Q_P,
    Q_Q,
    W,
)

SAMPLES = 16  # outputs handled at a time; a multiple of four
N_COEFFICIENTS = 5


@jit
def turn_to_output(table, r, start, shapes, direct, coefficients, states, lane):
    """Write one mode of one particle into its lane: coefficients, initial state, feed-through.

    Parameters
    ----------
    table, shapes, direct : array
        From `modal_system`; `direct` (s,) is updated.
    start : float
        First sample of the ground acceleration [m/s^2].
    coefficients, states : array (5 m, LANES), (2 m, LANES)
        Written.
    """
    w = table[W, r]
    out, cross = table[OUT_Q, r] / w, table[OUT_P, r]  # output of the state (w q, p)
    norm = out * out + cross * cross
    qq, qp, pq, pp = table[Q_Q, r], table[Q_P, r] * w, table[P_Q, r] / w, table[P_P, r]
    now_q, now_p = table[Q_NOW, r] * w, table[P_NOW, r]
    next_q, next_p = table[Q_NEXT, r] * w, table[P_NEXT, r]
    # rows of the turned transition T E, then times T' / norm, with T = [[out, cross], [-cross, out]]
    top_q, top_p = out * qq + cross * pq, out * qp + cross * pp
    low_q, low_p = out * pq - cross * qq, out * pp - cross * qp
    a11, a12 = (top_q * out + top_p * cross) / norm, (top_p * out - top_q * cross) / norm
    a21, a22 = (low_q * out + low_p * cross) / norm, (low_p * out - low_q * cross) / norm
    after_1, after_2 = out * next_q + cross * next_p, out * next_p - cross * next_q
    input_1 = a11 * after_1 + a12 * after_2 + out * now_q + cross * now_p
    input_2 = a21 * after_1 + a22 * after_2 + out * now_p - cross * now_q
    row = N_COEFFICIENTS * r
    coefficients[row, lane] = a11
    coefficients[row + 1, lane] = input_1
    coefficients[row + 2, lane] = a12 * a21
    coefficients[row + 3, lane] = a22
    coefficients[row + 4, lane] = a12 * input_2
    states[2 * r, lane] = -after_1 * start
    states[2 * r + 1, lane] = -a12 * after_2 * start
    for j in range(direct.size):
        direct[j] += shapes[j, r] * after_1


@jit
def fill_recursion(table, own_shapes, own_direct, start, lane, coefficients, states, shapes, direct):
    """Write one particle into its lane.

    Parameters
    ----------
    table, own_shapes, own_direct : arrays (11, m), (s, m), (s,)
        From `modal_system`; `own_direct` is overwritten.
    start : float
        First sample of the ground acceleration [m/s^2].
    coefficients, states, shapes, direct : array (..., LANES)
        Written; there are an even number of modes.
    """
    even_modes = states.shape[0] // 2
    for r in range(table.shape[1]):
        turn_to_output(table, r, start, own_shapes, own_direct, coefficients, states, lane)
    for j in range(own_direct.size):
        direct[j, lane] = own_direct[j]
        for r in range(table.shape[1]):
            shapes[j * even_modes + r, lane] = own_shapes[j, r]


@jit
def take_sums(errors, misfits, chained, n_times, result):
    """Write what `march` summed up into `result` (particles, s, 1), or (particles, s, 4) with `misfits`."""
    for lane in range(result.shape[0]):
        for j in range(result.shape[1]):
            result[lane, j, 0] = errors[j, lane] / n_times
            if misfits is not None:
                result[lane, j, 1] = chained[0][j, lane] / n_times
                result[lane, j, 2] = chained[1][j, lane]
                result[lane, j, 3] = chained[2][j, lane]


@jit
def advance_lanes(coefficients, states, ground, first, stride, outputs):
    """Write `SAMPLES` outputs of every mode into `outputs` (m SAMPLES, LANES) and carry the states on.

    `ground` has the ground acceleration at the steps of the recursion, from entry `first` on. Two modes go
    together, so that one does not wait for the other; an even number of modes.
    """
    for r in range(0, states.shape[0] // 2, 2):
        row = N_COEFFICIENTS * r
        a11, b1 = load(coefficients, row), load(coefficients, row + 1)
        a21, a22, b2 = load(coefficients, row + 2), load(coefficients, row + 3), load(coefficients, row + 4)
        c11, d1 = load(coefficients, row + 5), load(coefficients, row + 6)
        c21, c22, d2 = load(coefficients, row + 7), load(coefficients, row + 8), load(coefficients, row + 9)
        y1, y2 = load(states, 2 * r), load(states, 2 * r + 1)
        z1, z2 = load(states, 2 * r + 2), load(states, 2 * r + 3)
        for sample in range(SAMPLES):
            store(outputs, SAMPLES * r + sample, y1)
            store(outputs, SAMPLES * (r + 1) + sample, z1)
            for step in range(first + sample * stride, first + (sample + 1) * stride):
                a = splat(ground[step])
                y1, y2 = a11 * y1 + (y2 + b1 * a), a21 * y1 + (a22 * y2 + b2 * a)
                z1, z2 = c11 * z1 + (z2 + d1 * a), c21 * z1 + (c22 * z2 + d2 * a)
        store(states, 2 * r, y1)
        store(states, 2 * r + 1, y2)
        store(states, 2 * r + 2, z1)
        store(states, 2 * r + 3, z2)


@jit
def add_squares(shapes, direct, outputs, data, sample, ground, step, stride, errors, misfits):
    """Add the squared misfits of `SAMPLES` samples to `errors` (sensors, LANES); an even number of sensors.

    `shapes` (sensors m, LANES) and `direct` (sensors, LANES) belong to the lanes; `data` (sensors, time) from
    column `sample` on and `ground` from entry `step` on are common to all. The misfits are written into
    `misfits` (sensors SAMPLES, LANES), unless it is None.
    """
    n_modes = outputs.shape[0] // SAMPLES
    last = data.shape[0] - 1
    for j in range(0, errors.shape[0], 2):
        k = min(j + 1, last)  # an odd number of sensors is filled up with one of no consequence
        sum_a, sum_b = load(errors, j), load(errors, j + 1)
        direct_a, direct_b = load(direct, j), load(direct, j + 1)
        for t in range(0, SAMPLES, 4):
            g, i = step + t * stride, sample + t
            g0, g1 = splat(ground[g]), splat(ground[g + stride])
            g2, g3 = splat(ground[g + 2 * stride]), splat(ground[g + 3 * stride])
            a0, a1 = splat(data[j, i]) - direct_a * g0, splat(data[j, i + 1]) - direct_a * g1
            a2, a3 = splat(data[j, i + 2]) - direct_a * g2, splat(data[j, i + 3]) - direct_a * g3
            b0, b1 = splat(data[k, i]) - direct_b * g0, splat(data[k, i + 1]) - direct_b * g1
            b2, b3 = splat(data[k, i + 2]) - direct_b * g2, splat(data[k, i + 3]) - direct_b * g3
            for r in range(n_modes):
                shape_a, shape_b = load(shapes, j * n_modes + r), load(shapes, (j + 1) * n_modes + r)
                z0, z1 = load(outputs, SAMPLES * r + t), load(outputs, SAMPLES * r + t + 1)
                z2, z3 = load(outputs, SAMPLES * r + t + 2), load(outputs, SAMPLES * r + t + 3)
                a0, b0 = a0 - shape_a * z0, b0 - shape_b * z0
                a1, b1 = a1 - shape_a * z1, b1 - shape_b * z1
                a2, b2 = a2 - shape_a * z2, b2 - shape_b * z2
                a3, b3 = a3 - shape_a * z3, b3 - shape_b * z3
            sum_a = sum_a + ((a0 * a0 + a1 * a1) + (a2 * a2 + a3 * a3))
            sum_b = sum_b + ((b0 * b0 + b1 * b1) + (b2 * b2 + b3 * b3))
            if misfits is not None:
                row_a, row_b = SAMPLES * j + t, SAMPLES * (j + 1) + t
                store(misfits, row_a, a0)
                store(misfits, row_a + 1, a1)
                store(misfits, row_a + 2, a2)
                store(misfits, row_a + 3, a3)
                store(misfits, row_b, b0)
                store(misfits, row_b + 1, b1)
                store(misfits, row_b + 2, b2)
                store(misfits, row_b + 3, b3)
        store(errors, j, sum_a)
        store(errors, j + 1, sum_b)


@jit
def add_increments(misfits, count, is_first, increments, first, last):
    """Add the squared increments of `count` samples of `misfits`, and keep the first and last misfit.

    `increments`, `first` and `last` are (sensors, LANES); `last` has the misfit before these samples, unless
    they are the first.
    """
    for j in range(increments.shape[0]):
        row = SAMPLES * j
        if is_first:
            store(first, j, load(misfits, row))
            store(last, j, load(misfits, row))
        total, before = load(increments, j), load(last, j)
        for b in range(count):
            now = load(misfits, row + b)
            step = now - before
            total = total + step * step
            before = now
        store(increments, j, total)
        store(last, j, before)


@jit
def march(
    coefficients,
    states,
    shapes,
    direct,
    acceleration,
    substeps,
    stride,
    observed,
    errors,
    work,
    misfits,
    chained,
):
    """Sums of squares of all sensors for the particles of one vector, into `errors` (sensors, LANES).

    `work` has the arrays outputs (m SAMPLES, LANES), ground (SAMPLES stride,) and data (s, SAMPLES). Unless
    `misfits` (sensors SAMPLES, LANES) is None, `chained` gets the sums of squared increments, the first and
    the last misfits, each (sensors, LANES).
    """
    outputs, own_ground, own_data = work
    n_times = observed.shape[1]
    errors.fill(0.0)
    if misfits is not None:
        chained[0].fill(0.0)
    for first in range(0, n_times, SAMPLES):
        step, sample = first * stride, first
        ground, data = acceleration, observed
        if substeps > 1 or step + own_ground.size > acceleration.size:
            interpolate(acceleration, substeps, step, own_ground)
            ground, step = own_ground, 0
        count = n_times - first
        if count < SAMPLES:  # the end of the data: what lies behind it must come out as zero
            for k in range(count * stride, own_ground.size):
                own_ground[k] = 0.0
            for j in range(observed.shape[0]):
                for b in range(SAMPLES):
                    own_data[j, b] = observed[j, first + b] if b < count else 0.0
            data, sample = own_data, 0
        advance_lanes(coefficients, states, ground, step, stride, outputs)
        for r in range(outputs.shape[0] // SAMPLES):
            for b in range(count, SAMPLES):
                store(outputs, SAMPLES * r + b, splat(0.0))
        add_squares(shapes, direct, outputs, data, sample, ground, step, stride, errors, misfits)
        if misfits is not None:
            add_increments(misfits, min(count, SAMPLES), first == 0, *chained)
