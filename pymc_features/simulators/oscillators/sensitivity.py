"""Modal responses together with their derivatives, exact for an excitation linear between its samples.

In steps of the recursion, mode r obeys q" + d q' + s q = -a with s = (omega h)^2 and d = 2 zeta omega h
(`recursion.py`). Its derivative z = dq/ds obeys the same equation under the load q, and starts at rest; so
does dq/dd, under the load q', and is therefore z'. One more pair (z, z') beside (q, q') gives all
derivatives:

    z" = -q - d z' - s z,    z"' = -q' - d z" - s z',    dq"/ds = z",  dq"/dd = z"'.

The pair moves on by the derivatives with respect to s of the transition and input coefficients, which come
from the same Taylor series and doublings as these. Modes lie in the lanes of vector registers.
"""

import numpy as np

from pymc_features.simulators.chain.modes import chain_modes
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, load, splat, store
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    RELATIVE_DISPLACEMENT,
)
from pymc_features.simulators.oscillators.recursion import (
    BLOCK,
    N_ROWS,
    P_NEXT,
    P_NOW,
    P_P,
    P_Q,
    Q_NEXT,
    Q_NOW,
    Q_P,
    Q_Q,
    TAYLOR_TERMS,
    first_order_hold,
)

# Coefficients of a mode: eight of the step, their derivatives with respect to s, and outputs
N_STEP = 8
N_OUTPUT = 11
N_COEFFICIENTS = 2 * N_STEP + N_OUTPUT
STEP_ROWS = (Q_Q, Q_P, P_Q, P_P, Q_NOW, P_NOW, Q_NEXT, P_NEXT)


@jit
def hold_derivative(w, zeta, derivative):
    """Write the derivatives with respect to s = w^2, at fixed d, of the eight step coefficients.

    Parameters as in `recursion.first_order_hold`; `derivative` (8,) in the order of `STEP_ROWS`.
    """
    square, drag, share = w * w, 2.0 * zeta * w, 1.0  # share: derivative of `square`
    halvings = 0
    while max(square, drag * drag) > 0.0625:
        square, drag, share = 0.25 * square, 0.5 * drag, 0.25 * share
        halvings += 1
    a2, b2, da2, db2 = 1.0, 0.0, 0.0, 0.0
    for k in range(TAYLOR_TERMS, 2, -1):
        a2, b2, da2, db2 = (
            1.0 - square * b2 / k,
            (a2 - drag * b2) / k,
            -(share * b2 + square * db2) / k,
            (da2 - drag * db2) / k,
        )
    a2, b2, da2, db2 = 0.5 * a2, 0.5 * b2, 0.5 * da2, 0.5 * db2
    a1, b1 = 1.0 - square * b2, a2 - drag * b2
    da1, db1 = -share * b2 - square * db2, da2 - drag * db2
    a0, b0 = 1.0 - square * b1, a1 - drag * b1
    da0, db0 = -share * b1 - square * db1, da1 - drag * db1
    for _ in range(halvings):
        grown, mixed, dmixed = 1.0 + a0, 1.0 + a0 - drag * b0, da0 - drag * db0
        load_b, dload_b = square * b0, share * b0 + square * db0
        da2, db2 = (
            0.25 * (da0 * a2 + grown * da2 - dload_b * b2 - load_b * db2 + da1),
            0.125 * (dmixed * b2 + mixed * db2 + db0 * a2 + b0 * da2 + db1),
        )
        a2, b2 = 0.25 * (grown * a2 - load_b * b2 + a1), 0.125 * (mixed * b2 + b0 * a2 + b1)
        da1, db1 = (
            0.5 * (da0 * a1 + grown * da1 - dload_b * b1 - load_b * db1),
            0.25 * (dmixed * b1 + mixed * db1 + db0 * a1 + b0 * da1),
        )
        a1, b1 = 0.5 * (grown * a1 - load_b * b1), 0.25 * (mixed * b1 + b0 * a1)
        da0, db0 = (
            2.0 * a0 * da0 - dload_b * b0 - load_b * db0,
            0.5 * (db0 * (2.0 * a0 - drag * b0) + b0 * (2.0 * da0 - drag * db0)),
        )
        a0, b0 = a0 * a0 - load_b * b0, 0.5 * b0 * (2.0 * a0 - drag * b0)
        square, drag, share = 4.0 * square, 2.0 * drag, 4.0 * share
    derivative[0], derivative[1] = da0, db0
    derivative[2], derivative[3] = -b0 - square * db0, da0 - drag * db0
    derivative[4], derivative[5] = db2 - db1, da2 - da1 - drag * (db2 - db1)
    derivative[6], derivative[7] = -db2, drag * db2 - da2


@jit
def output_coefficients(quantity, s, d, step, slope, row):
    """Write how a mode's output f and its derivatives follow from its state (q, q', z, z').

    Parameters
    ----------
    s, d, step : float
        As above; `step` h [s].
    slope : float
        Derivative of 2 zeta omega with respect to lambda = omega^2 along the damping's own law [s].
    row : array (11,)
        Written: df/dlambda, in total, and df/dd, each from q, q', z, z'; f from q, q' and the ground
        acceleration. For accelerations f is relative: the ground's is added to what the sensors put out.
    """
    row[:] = 0.0
    f = row[8:]
    if quantity == RELATIVE_DISPLACEMENT:
        unit = step * step
        f[0] = unit
        by_s, by_d = (0.0, 0.0, unit, 0.0), (0.0, 0.0, 0.0, unit)
    elif quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION):
        f[0], f[1], f[2] = -s, -d, -1.0
        by_s, by_d = (-1.0, 0.0, -s, -d), (d, -1.0, s * d, d * d - s)
    else:
        f[1] = step
        by_s, by_d = (0.0, 0.0, 0.0, step), (-step, 0.0, -s * step, -d * step)
    for i in range(4):
        row[i] = step * step * by_s[i] + step * slope * by_d[i]
        row[4 + i] = by_d[i]


@jit
def fill_mode(w, zeta, slope, step, quantity, r, work, coefficients):
    """Write what mode `r` needs into `coefficients` (27 groups, LANES).

    Parameters
    ----------
    w, zeta, slope, step
        As in `recursion.first_order_hold` and `output_coefficients`.
    work : tuple of arrays (11, 1), (8,), (11,)
        Overwritten.
    """
    table, derivative, output = work
    first_order_hold(w, zeta, table, 0)
    hold_derivative(w, zeta, derivative)
    output_coefficients(quantity, w * w, 2.0 * zeta * w, step, slope, output)
    first, lane = N_COEFFICIENTS * (r // LANES), r % LANES
    for i in range(N_STEP):
        coefficients[first + i, lane] = table[STEP_ROWS[i], 0]
        coefficients[first + N_STEP + i, lane] = derivative[i]
    for i in range(N_OUTPUT):
        coefficients[first + 2 * N_STEP + i, lane] = output[i]


@jit
def sensitive_modes(mass, stiffness, rayleigh, ratios, step, n_modes, quantity):
    """Modes, and the coefficients of their recursion with derivatives.

    Parameters as in `recursion.modal_system`.

    Returns
    -------
    valid : bool
        False if the parameters describe no structure.
    omega, participation : array (n,)
        Angular frequencies [rad/s] and phi_r' M 1.
    mode_shapes : array (n, n)
        Rows are mass-normalised.
    coefficients : array (27 groups, LANES)
        Of `advance_modes`; zero in lanes without a mode.
    """
    n = mass.size
    omega, participation, mode_shapes = np.empty(n), np.empty(n), np.empty((n, n))
    groups = (n_modes + LANES - 1) // LANES
    coefficients = np.zeros((N_COEFFICIENTS * groups, LANES))
    work = np.empty((N_ROWS, 1)), np.empty(N_STEP), np.empty(N_OUTPUT)
    valid = chain_modes(mass, stiffness, omega, mode_shapes, participation)
    for r in range(n_modes if valid else 0):
        w = omega[r] * step
        zeta = 0.5 * (rayleigh[0] / omega[r] + rayleigh[1] * omega[r]) + ratios[r]
        if not (w < 1e6 and 0.0 <= zeta * w < 1e6):
            valid = False
            break
        slope = rayleigh[1] + ratios[r] / omega[r]
        fill_mode(w, zeta, slope, step, quantity, r, work, coefficients)
    return valid, omega, participation, mode_shapes, coefficients


@jit
def load_four(array, row):
    """Four rows of an array (rows, LANES)."""
    return load(array, row), load(array, row + 1), load(array, row + 2), load(array, row + 3)


@jit
def advance_modes(coefficients, states, ground, stride, values, by_lambda, by_damping):
    """Write `BLOCK` samples of every mode's output and derivatives, and carry the states on.

    Parameters
    ----------
    coefficients : array (27 groups, LANES)
        From `sensitive_modes`.
    states : array (4 groups, LANES)
        q, q', z, z'; overwritten.
    ground : array (BLOCK stride + 1,)
        Ground acceleration at the steps of the recursion.
    values, by_lambda, by_damping : array (BLOCK groups, LANES)
        Written: f, df/dlambda in total, df/dd; row `sample * groups + group`.
    """
    groups = states.shape[0] // 4
    for group in range(groups):
        i, k = N_COEFFICIENTS * group, 4 * group
        qq, qp, pq, pp = load_four(coefficients, i)
        qn, pn, qa, pa = load_four(coefficients, i + 4)
        dqq, dqp, dpq, dpp = load_four(coefficients, i + N_STEP)
        dqn, dpn, dqa, dpa = load_four(coefficients, i + N_STEP + 4)
        lq, lp, ly, lz = load_four(coefficients, i + 2 * N_STEP)
        dq, dp, dy, dz = load_four(coefficients, i + 2 * N_STEP + 4)
        fq, fp = load(coefficients, i + 2 * N_STEP + 8), load(coefficients, i + 2 * N_STEP + 9)
        fa = load(coefficients, i + 2 * N_STEP + 10)
        q, p, y, z = load_four(states, k)
        for sample in range(BLOCK):
            row = sample * groups + group
            first = sample * stride
            store(values, row, fq * q + fp * p + fa * splat(ground[first]))
            store(by_lambda, row, lq * q + lp * p + ly * y + lz * z)
            store(by_damping, row, dq * q + dp * p + dy * y + dz * z)
            for step in range(first, first + stride):
                a, b = splat(ground[step]), splat(ground[step + 1])
                y, z = (
                    qq * y + qp * z + dqq * q + dqp * p + dqn * a + dqa * b,
                    pq * y + pp * z + dpq * q + dpp * p + dpn * a + dpa * b,
                )
                q, p = qq * q + qp * p + qn * a + qa * b, pq * q + pp * p + pn * a + pa * b
        store(states, k, q)
        store(states, k + 1, p)
        store(states, k + 2, y)
        store(states, k + 3, z)
