"""Exact modal response to an excitation that is linear between its samples.

Mode r of Eqs. (20)-(22), per unit participation, obeys q" + 2 zeta omega q' + omega^2 q = -a_g(t).
In the state x = (q, h q') / h^2 with the step h, and with a_g linear over the step, the exact
solution (first-order hold) is

    x[k+1] = phi0(F) x[k] - (phi1(F) - phi2(F)) e2 a[k] - phi2(F) e2 a[k+1],
    F = [[0, 1], [-w^2, -2 zeta w]],   w = omega h,   e2 = (0, 1),

with phi0 = exp, phi1(z) = (e^z - 1)/z, phi2(z) = (e^z - 1 - z)/z^2. The closed forms of these
coefficients lose digits for small w and change at critical damping. Here F is halved until the
Taylor series converges fast, then the functions are doubled back by identities without cancellation,

    phi0(2z) = phi0(z)^2,  2 phi1(2z) = (1 + phi0(z)) phi1(z),  4 phi2(2z) = (1 + phi0(z)) phi2(z) + phi1(z),

good for every frequency and damping, rigid-body and overdamped modes included. A function of F is
held as a pair (a, b) standing for a I + b F, since F^2 = -w^2 I - 2 zeta w F.
"""

import numpy as np

from pymc_features.simulators.chain.modes import chain_modes
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    RELATIVE_DISPLACEMENT,
    RELATIVE_VELOCITY,
    n_outputs,
)

BLOCK = 128  # output samples handled at a time: the working set stays in the first-level cache
TAYLOR_TERMS = 13  # with |F| <= 1/4 the first dropped term is below 1e-19

# Rows of the recursion table: state transition, excitation at both ends of the step, output, omega h
Q_Q, Q_P, P_Q, P_P, Q_NOW, P_NOW, Q_NEXT, P_NEXT, OUT_Q, OUT_P, W = range(11)
N_ROWS = 11


@jit
def first_order_hold(w, zeta, table, r):
    """Write the step coefficients of one mode into column `r` of `table` (11, modes).

    Parameters
    ----------
    w, zeta : float
        Angular frequency times step, omega h [-], and damping ratio [-].
    """
    square = w * w
    drag = 2.0 * zeta * w
    halvings = 0
    while max(square, drag * drag) > 0.0625:
        square *= 0.25
        drag *= 0.5
        halvings += 1
    a2, b2 = 1.0, 0.0
    for k in range(TAYLOR_TERMS, 2, -1):  # Horner: 2 phi2 = 1 + F/3 (1 + F/4 (1 + ...))
        a2, b2 = 1.0 - square * b2 / k, (a2 - drag * b2) / k
    a2, b2 = 0.5 * a2, 0.5 * b2
    a1, b1 = 1.0 - square * b2, a2 - drag * b2  # phi1 = 1 + F phi2
    a0, b0 = 1.0 - square * b1, a1 - drag * b1  # phi0 = 1 + F phi1
    for _ in range(halvings):
        grown = 1.0 + a0
        mixed = grown - drag * b0
        a2, b2 = (
            0.25 * (grown * a2 - square * b0 * b2 + a1),
            0.125 * (mixed * b2 + b0 * a2 + b1),
        )
        a1, b1 = 0.5 * (grown * a1 - square * b0 * b1), 0.25 * (mixed * b1 + b0 * a1)
        a0, b0 = a0 * a0 - square * b0 * b0, 0.5 * b0 * (2.0 * a0 - drag * b0)
        square *= 4.0
        drag *= 2.0
    table[W, r] = w
    table[Q_Q, r] = a0
    table[Q_P, r] = b0
    table[P_Q, r] = -square * b0
    table[P_P, r] = a0 - drag * b0
    table[Q_NOW, r] = b2 - b1
    table[P_NOW, r] = a2 - a1 - drag * (b2 - b1)
    table[Q_NEXT, r] = -b2
    table[P_NEXT, r] = drag * b2 - a2


@jit
def output_row(quantity, w, zeta, step, table, r):
    """Write what mode `r` adds to the wanted quantity, Eq. (24), from its state."""
    if quantity == RELATIVE_DISPLACEMENT:
        table[OUT_Q, r], table[OUT_P, r] = step * step, 0.0
    elif quantity == RELATIVE_VELOCITY:
        table[OUT_Q, r], table[OUT_P, r] = 0.0, step
    else:
        table[OUT_Q, r], table[OUT_P, r] = -w * w, -2.0 * zeta * w


@jit
def modal_system(mass, stiffness, rayleigh, ratios, step, sensors, n_modes, quantity):
    """Everything the recursion needs, computed once for each set of parameters.

    Parameters
    ----------
    mass, stiffness, ratios : array (n,)
        Masses [kg], springs [N/m], and damping ratios [-] added to the Rayleigh damping.
    rayleigh : array (2,)
        alpha [1/s] and beta [s].
    step : float
        Step of the recursion [s].
    sensors : integer array (s,)
        Degrees of freedom, 0 next to the base.
    n_modes, quantity : int
        Modes kept, and a position in `QUANTITIES`.

    Returns
    -------
    valid : bool
        False if the parameters describe no structure.
    table : array (11, n_modes)
        Recursion and output coefficients.
    shapes : array (s, n_modes)
        phi_r Gamma_r at the sensors.
    direct : array (s,)
        Feed-through of the ground acceleration, J_c of Eq. (24): zero for the absolute
        acceleration with all modes kept.
    """
    n = mass.size
    omega = np.empty(n)
    participation = np.empty(n)
    mode_shapes = np.empty((n, n))
    table = np.empty((N_ROWS, n_modes))
    shapes = np.empty((sensors.size, n_modes))
    direct = np.zeros(sensors.size)
    valid = chain_modes(mass, stiffness, omega, mode_shapes, participation) and modal_coefficients(
        omega, mode_shapes, participation, rayleigh, ratios, step, sensors, quantity, table, shapes, direct
    )
    return valid, table, shapes, direct


@jit
def modal_coefficients(
    omega, mode_shapes, participation, rayleigh, ratios, step, sensors, quantity, table, shapes, direct
):
    """Write `table`, `shapes` and `direct` of `modal_system` from the modes; False where damping is bad."""
    n_modes = table.shape[1]
    for r in range(n_modes):
        w = omega[r] * step
        zeta = 0.5 * (rayleigh[0] / omega[r] + rayleigh[1] * omega[r]) + ratios[r]
        if not (w < 1e6 and 0.0 <= zeta * w < 1e6):  # NaN, growing, or absurdly stiff
            return False
        first_order_hold(w, zeta, table, r)
        output_row(quantity, w, zeta, step, table, r)
    for j in range(sensors.size):
        carried = 0.0
        for r in range(n_modes):
            shapes[j, r] = mode_shapes[r, sensors[j]] * participation[r]
            carried += shapes[j, r]
        if n_modes == omega.size:
            carried = 1.0  # completeness of the modes, without its rounding error
        if quantity == ABSOLUTE_ACCELERATION:
            direct[j] = 1.0 - carried
        elif quantity == RELATIVE_ACCELERATION:
            direct[j] = -carried
        else:
            direct[j] = 0.0
    return True


@jit
def advance(table, q, p, acceleration, substeps, stride, first, count, modal, ground):
    """Carry the modal states through output samples `first` ... `first + count - 1`.

    Parameters
    ----------
    table : array (11, m)
        From `modal_system`.
    q, p : array (m,)
        Modal states; overwritten. At rest before sample 0.
    acceleration : array (t,)
        Ground acceleration at the record's samples [m/s^2].
    substeps, stride : int
        The recursion makes `substeps` steps between two record samples, and every `stride`-th
        state is an output.
    modal, ground : array (>= count, m), (>= count,)
        Written: modal outputs and ground acceleration at the output samples.
    """
    n_modes = q.size
    for b in range(count):
        sample = first + b
        for fine in range(max(sample - 1, 0) * stride, sample * stride):
            i = fine // substeps
            slope = (acceleration[i + 1] - acceleration[i]) / substeps
            now = acceleration[i] + (fine - i * substeps) * slope
            after = now + slope
            for r in range(n_modes):
                q_r = (
                    table[Q_Q, r] * q[r]
                    + table[Q_P, r] * p[r]
                    + (table[Q_NOW, r] * now + table[Q_NEXT, r] * after)
                )
                p[r] = (
                    table[P_Q, r] * q[r]
                    + table[P_P, r] * p[r]
                    + (table[P_NOW, r] * now + table[P_NEXT, r] * after)
                )
                q[r] = q_r
        i = sample * stride // substeps
        weight = (sample * stride - i * substeps) / substeps
        ground[b] = acceleration[i]
        if weight > 0.0:
            ground[b] += weight * (acceleration[i + 1] - acceleration[i])
        for r in range(n_modes):
            modal[b, r] = table[OUT_Q, r] * q[r] + table[OUT_P, r] * p[r]


@jit
def check_sizes(mass, stiffness, rayleigh, ratios, sensors, n_modes):
    """Refuse inputs whose sizes would make the kernels read outside their arrays."""
    n_dof = mass.size
    if stiffness.size != n_dof or ratios.size != n_dof or rayleigh.size != 2:
        raise ValueError("`mass`, `stiffness` and damping `ratios` must have equal lengths")
    for j in range(sensors.size):
        if sensors[j] < 0 or sensors[j] >= n_dof:
            raise ValueError("`sensors` must be degrees of freedom of the structure")
    if n_modes < 1 or n_modes > n_dof:
        raise ValueError("`n_modes` must lie between 1 and the number of degrees of freedom")


@jit
def chain_response(parameters, excitation, wanted):
    """Response history of a spring-mass chain, Eqs. (17)-(24), exact for a linear excitation.

    Parameters as in `modal_system` and `advance`; `dt` is the record's step [s]. Returns an array
    (s, u); all NaN where the parameters describe no structure.
    """
    mass, stiffness, rayleigh, ratios = parameters
    acceleration, dt, substeps, stride = excitation
    sensors, n_modes, quantity = wanted
    check_sizes(mass, stiffness, rayleigh, ratios, sensors, n_modes)
    total = n_outputs(acceleration.size, substeps, stride)
    response = np.empty((sensors.size, total))
    valid, table, shapes, direct = modal_system(
        mass, stiffness, rayleigh, ratios, dt / substeps, sensors, n_modes, quantity
    )
    if not valid:
        response[:] = np.nan
        return response
    q = np.zeros(n_modes)
    p = np.zeros(n_modes)
    modal = np.empty((BLOCK, n_modes))
    ground = np.empty(BLOCK)
    block = np.empty((sensors.size, BLOCK))
    for first in range(0, total, BLOCK):
        count = min(BLOCK, total - first)
        advance(table, q, p, acceleration, substeps, stride, first, count, modal, ground)
        np.dot(shapes, modal.T, block)
        for j in range(sensors.size):
            for b in range(count):
                response[j, first + b] = block[j, b] + direct[j] * ground[b]
    return response
