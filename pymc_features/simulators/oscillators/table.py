"""The recursion of modes through a record: its table, and steps, with modes in the lanes of vectors."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import address, read_lanes, read_number, write_lanes
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY
from pymc_features.simulators.oscillators.exact_step import exponentials, pole_of_mode

SMALLEST = 1e-100  # replaces omega h = 0: its square is lost beside anything else

# Rows of the recursion table: state transition, excitation at both ends of the step, output, omega h
Q_Q, Q_P, P_Q, P_P, Q_NOW, P_NOW, Q_NEXT, P_NEXT, OUT_Q, OUT_P, W = range(11)
N_ROWS = 11


@jit
def first_order_hold(s, d):
    """Coefficients of one step of (q, h q'), in the order of the first eight rows of the table.

    A function of F = [[0, 1], [-s, -d]] is a I + b F, of the pole z = -d/2 + J of F it is re + im J.
    """
    phi_0, phi_1, phi_2 = exponentials(pole_of_mode(s, d), s, d)
    (b0, b1, b2), half = (phi_0.im, phi_1.im, phi_2.im), 0.5 * d
    a0, a1, a2 = phi_0.re + half * b0, phi_1.re + half * b1, phi_2.re + half * b2
    now_q, now_p = b2 - b1, a2 - a1 - d * (b2 - b1)
    return a0, b0, -s * b0, a0 - d * b0, now_q, now_p, -b2, d * b2 - a2


@jit
def whole_vectors(n_modes):
    """Number of modes, filled up with some that stay at rest."""
    return (n_modes + LANES - 1) // LANES * LANES


@jit
def new_outputs(count, n_modes):
    """Room (count, m) for `advance`, which writes whole vectors: the last of them ends behind it."""
    return np.zeros(count * n_modes + LANES)[: count * n_modes].reshape((count, n_modes))


@jit
def write_table(omega, damping, step, quantity, table):
    """Write the recursion and the output of each mode, Eq. (24), from its state (q, q').

    Parameters
    ----------
    omega, damping : array (m,)
        [rad/s] and D [1/s], not negative.
    step : float
        Of the recursion [s].
    quantity : int
        Position in `QUANTITIES`.
    table : array (11, m)
    """
    for r in range(omega.size):
        w, d = max(omega[r] * step, SMALLEST), damping[r] * step
        hold = first_order_hold(w * w, d)
        for i in range(8):
            table[i, r] = hold[i]
        if quantity == RELATIVE_DISPLACEMENT:
            table[OUT_Q, r], table[OUT_P, r] = step * step, 0.0
        elif quantity == RELATIVE_VELOCITY:
            table[OUT_Q, r], table[OUT_P, r] = 0.0, step
        else:
            table[OUT_Q, r], table[OUT_P, r] = -w * w, -d
        table[W, r] = w


@jit
def scale_input(table, participation):
    """Multiply the excitation of a recursion table (11, m) by Gamma (m,) of an input."""
    for row in range(Q_NOW, P_NEXT + 1):
        for r in range(participation.size):
            table[row, r] *= participation[r]


@jit
def advance(table, is_first, states, ground, stride, count, outputs):
    """Write `count` outputs of every mode, or add them, and carry the states to the sample behind them.

    Two vectors of modes go together, so that one does not wait for the other. Where a vector ends behind the
    modes of a sample, what it writes there is written again by the next sample, or by the vectors before it.

    Parameters
    ----------
    table : array (11, m)
        From `write_table`, after `scale_input`; zero behind the modes up to `whole_vectors` of them.
    is_first : bool
        Whether the outputs are written; those of other inputs are added.
    states : array (2, m)
        States q and p of all modes in the table at the first of these samples, at rest at the beginning;
        overwritten.
    ground : array (> count stride,)
        Excitation at the steps of the recursion.
    stride : int
        Every `stride`-th state is an output.
    outputs : array (>= count, m)
        From `new_outputs`; updated.
    """
    n_vectors, steps = table.shape[1] // LANES, (stride, count, is_first)
    width, at = outputs.shape[1], (address(table), address(states), address(ground), address(outputs))
    for k in range(n_vectors - 2, -1, -2):
        advance_two(at, n_vectors, k, width, steps)
    if n_vectors % 2:
        advance_one(at, n_vectors, width, steps)


@jit
def coefficients(table, n_vectors, k):
    """The rows of the table of vector k, in their order, without the last."""
    return (
        (read_lanes(table, k), read_lanes(table, n_vectors + k)),
        (read_lanes(table, 2 * n_vectors + k), read_lanes(table, 3 * n_vectors + k)),
        (read_lanes(table, 4 * n_vectors + k), read_lanes(table, 5 * n_vectors + k)),
        (read_lanes(table, 6 * n_vectors + k), read_lanes(table, 7 * n_vectors + k)),
        (read_lanes(table, 8 * n_vectors + k), read_lanes(table, 9 * n_vectors + k)),
    )


@jit
def stepped(rows, q, p, now, after):
    """States after a step."""
    (q_q, q_p), (p_q, p_p), (q_now, p_now), (q_next, p_next), _ = rows
    return (
        q_q * q + (q_p * p + (q_now * now + q_next * after)),
        p_q * q + (p_p * p + (p_now * now + p_next * after)),
    )


@jit
def put(outputs, is_first, rows, q, p):
    """Write or add the outputs of a vector of modes at an address."""
    out_q, out_p = rows[4]
    value = out_q * q + out_p * p
    write_lanes(outputs, 0, value if is_first else read_lanes(outputs, 0) + value)


@jit
def advance_one(at, n_vectors, width, steps):
    """Advance the first vector of modes; `at` are addresses, `width` the number of modes."""
    (table, states, ground, outputs), (stride, count, is_first) = at, steps
    rows = coefficients(table, n_vectors, 0)
    q, p = read_lanes(states, 0), read_lanes(states, n_vectors)
    for b in range(count):
        put(outputs + 8 * b * width, is_first, rows, q, p)
        for step in range(b * stride, (b + 1) * stride):
            now, after = splat(read_number(ground, step)), splat(read_number(ground, step + 1))
            q, p = stepped(rows, q, p, now, after)
    write_lanes(states, 0, q)
    write_lanes(states, n_vectors, p)


@jit
def advance_two(at, n_vectors, k, width, steps):
    """Advance vectors k and k + 1 of modes together."""
    (table, states, ground, outputs), (stride, count, is_first) = at, steps
    rows_a, rows_b = coefficients(table, n_vectors, k), coefficients(table, n_vectors, k + 1)
    qa, pa = read_lanes(states, k), read_lanes(states, n_vectors + k)
    qb, pb = read_lanes(states, k + 1), read_lanes(states, n_vectors + k + 1)
    for b in range(count):
        here = outputs + 8 * (b * width + k * LANES)
        put(here + 8 * LANES, is_first, rows_b, qb, pb)
        put(here, is_first, rows_a, qa, pa)
        for step in range(b * stride, (b + 1) * stride):
            now, after = splat(read_number(ground, step)), splat(read_number(ground, step + 1))
            qa, pa = stepped(rows_a, qa, pa, now, after)
            qb, pb = stepped(rows_b, qb, pb, now, after)
    write_lanes(states, k, qa)
    write_lanes(states, n_vectors + k, pa)
    write_lanes(states, k + 1, qb)
    write_lanes(states, n_vectors + k + 1, pb)
