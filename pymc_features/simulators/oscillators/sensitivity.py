"""Modal responses together with their derivatives, exact for an excitation linear between its samples.

In steps of the recursion, mode r obeys q" + d q' + s q = -a with s = (omega h)^2 and d = D h
(`recursion.py`). Its derivative z = dq/ds obeys the same equation under the load q, and starts at rest; so
does dq/dd, under the load q', and is therefore z'. One more pair (z, z') beside (q, q') gives all
derivatives:

    z" = -q - d z' - s z,    z"' = -q' - d z" - s z',    dq"/ds = z",  dq"/dd = z"'.

The pair moves on by the derivatives with respect to s of the transition and input coefficients: the
imaginary parts of the coefficients at s + i 1e-200, exact to rounding (Squire & Trapp, SIAM Review 40, 1998).
Modes lie in the lanes of vector registers.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, load, splat, store
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    RELATIVE_DISPLACEMENT,
)
from pymc_features.simulators.oscillators.hold import first_order_hold
from pymc_features.simulators.oscillators.recursion import BLOCK
from pymc_features.simulators.oscillators.table import SMALLEST

# Coefficients of a mode: eight of the step, their derivatives with respect to s, and outputs
N_STEP = 8
N_OUTPUT = 11
N_COEFFICIENTS = 2 * N_STEP + N_OUTPUT
TINY = 1e-200  # of the complex step: its square underflows


@jit
def output_coefficients(quantity, s, d, step, slope, row):
    """Write how a mode's output f and its derivatives follow from its state (q, q', z, z').

    Parameters
    ----------
    s, d, step : float
        As above; `step` h [s].
    slope : float
        Derivative of D with respect to lambda = omega^2 along the damping's own law [s].
    row : array (11,)
        Written: df/dlambda, in total, and df/dd, each from q, q', z, z'; f from q, q' and the ground
        acceleration. For accelerations f is relative: the ground's is added to what the sensors put out.
    """
    row[:] = 0.0
    f = row[8:]
    if quantity == RELATIVE_DISPLACEMENT:
        unit = step * step
        f[0] = unit
        f_s, f_d = (0.0, 0.0, unit, 0.0), (0.0, 0.0, 0.0, unit)
    elif quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION):
        f[0], f[1], f[2] = -s, -d, -1.0
        f_s, f_d = (-1.0, 0.0, -s, -d), (d, -1.0, s * d, d * d - s)
    else:
        f[1] = step
        f_s, f_d = (0.0, 0.0, 0.0, step), (-step, 0.0, -s * step, -d * step)
    for i in range(4):
        row[i] = step * step * f_s[i] + step * slope * f_d[i]
        row[4 + i] = f_d[i]


@jit
def sensitivity_coefficients(system, law, step, quantity):
    """Coefficients (27 groups, LANES) of `advance_modes`; zero in lanes without a mode.

    Parameters
    ----------
    system : ModalSystem
    law : DampingLaw
    step : float
        Of the recursion [s].
    quantity : int
        Position in `QUANTITIES`.
    """
    omega, damping = system.omega, system.damping
    groups = (omega.size + LANES - 1) // LANES
    coefficients, output = np.zeros((N_COEFFICIENTS * groups, LANES)), np.empty(N_OUTPUT)
    for r in range(omega.size):
        slope = law.rayleigh[1]  # of D = alpha + beta lambda + 2 ratio sqrt(lambda)
        if omega[r] > 0.0:  # nothing changes the lambda of a rigid body
            slope += law.ratios[r] / omega[r]
        s, d = max(omega[r] * step, SMALLEST) ** 2, damping[r] * step
        hold, change = first_order_hold(s, d), first_order_hold(complex(s, TINY), d)
        output_coefficients(quantity, s, d, step, slope, output)
        first, lane = N_COEFFICIENTS * (r // LANES), r % LANES
        for i in range(N_STEP):
            coefficients[first + i, lane] = hold[i]
            coefficients[first + N_STEP + i, lane] = change[i].imag / TINY
        for i in range(N_OUTPUT):
            coefficients[first + 2 * N_STEP + i, lane] = output[i]
    return coefficients


@jit
def load_four(array, row):
    """Four rows of an array (rows, LANES)."""
    return load(array, row), load(array, row + 1), load(array, row + 2), load(array, row + 3)


@jit
def advance_modes(coefficients, states, ground, stride, values, f_lambda, f_damping):
    """Write `BLOCK` samples of every mode's output and derivatives, and carry the states on.

    Parameters
    ----------
    coefficients : array (27 groups, LANES)
        From `sensitivity_coefficients`.
    states : array (4 groups, LANES)
        q, q', z, z'; overwritten.
    ground : array (BLOCK stride + 1,)
        Excitation at the steps of the recursion.
    values, f_lambda, f_damping : array ((BLOCK + 1) groups, LANES)
        Written: f, df/dlambda in total, df/dd; row `(sample + 1) * groups + group`.
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
            row = (sample + 1) * groups + group
            first = sample * stride
            store(values, row, fq * q + fp * p + fa * splat(ground[first]))
            store(f_lambda, row, lq * q + lp * p + ly * y + lz * z)
            store(f_damping, row, dq * q + dp * p + dy * y + dz * z)
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
