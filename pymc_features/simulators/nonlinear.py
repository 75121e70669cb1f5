"""Response of a chain with nonlinear springs, for an excitation that is linear between its samples."""

import numpy as np

from pymc_features.simulators.compilation import jit
from pymc_features.simulators.modal import chain_modes
from pymc_features.simulators.recursion import (
    ABSOLUTE_ACCELERATION,
    QUANTITIES,
    RELATIVE_ACCELERATION,
    RELATIVE_DISPLACEMENT,
    RELATIVE_VELOCITY,
    check_sizes,
    n_outputs,
)
from pymc_features.simulators.restoring import is_law, spring
from pymc_features.simulators.runge_kutta import LAST, System, Workspace, advance, write_slope

# What else can be asked of a spring, after the codes of `QUANTITIES`
SPRING_FORCE, DRIFT, MEMORY = range(len(QUANTITIES), len(QUANTITIES) + 3)


@jit
def linear_part(law, mass, stiffness, rayleigh, ratios):
    """The initial chain: whether it is one, its highest rate of change [1/s], and M^-1 C of `ratios`."""
    n = mass.size
    omega, participation, shapes = np.empty(n), np.empty(n), np.empty((n, n))
    modal = np.zeros((0, 0))
    valid = chain_modes(mass, stiffness, omega, shapes, participation)
    highest = 0.0
    any_ratio = False
    for r in range(n):
        valid &= is_law(law, r)
        drag = rayleigh[0] + rayleigh[1] * omega[r] ** 2 + 2.0 * ratios[r] * omega[r]
        valid &= 0.0 <= drag < np.inf
        highest = max(highest, omega[r] + drag)
        any_ratio |= ratios[r] != 0.0
    if valid and any_ratio:  # sum of 2 zeta_r omega_r phi_r phi_r' M
        modal = np.zeros((n, n))
        for r in range(n):
            for i in range(n):
                weight = 2.0 * ratios[r] * omega[r] * shapes[r, i]
                for j in range(n):
                    modal[i, j] += weight * shapes[r, j] * mass[j]
    return valid, highest, modal


@jit
def output_value(law, system, work, ground, quantity, i):
    """One quantity at degree of freedom, or spring, `i`."""
    n = system.stiffness.size
    u, v = work.state[i], work.state[n + i]
    if quantity == ABSOLUTE_ACCELERATION:
        return work.stages[0, n + i] + ground
    if quantity == RELATIVE_ACCELERATION:
        return work.stages[0, n + i]
    if quantity == RELATIVE_VELOCITY:
        return v
    if quantity == RELATIVE_DISPLACEMENT:
        return u
    if quantity == MEMORY:
        return work.state[2 * n + i]
    drift = u - (work.state[i - 1] if i > 0 else 0.0)
    if quantity == DRIFT:
        return drift
    return spring(law, i, system.stiffness[i], drift, v, work.state[2 * n + i])[0]


@jit
def history_kernel(
    law, mass, stiffness, rayleigh, ratios, acceleration, dt, substeps, stride, sensors, quantities, refine
):
    """Histories (quantity, sensor, time) of a chain whose springs follow `law`, at rest at first.

    Parameters as of `chain_response`; `quantities` are codes, and `refine` divides every step. All NaN
    where the parameters describe no structure or the integration fails.
    """
    check_sizes(mass, stiffness, rayleigh, ratios, sensors, mass.size)
    n = mass.size
    total = n_outputs(acceleration.size, substeps, stride)
    history = np.empty((quantities.size, sensors.size, total))
    valid, omega, modal = linear_part(law, mass, stiffness, rayleigh, ratios)
    system = System(1.0 / mass, stiffness, rayleigh, modal)
    work = Workspace(
        np.zeros(3 * n), np.zeros((LAST + 1, 3 * n)), np.zeros(3 * n), np.zeros(2 * n, dtype=np.uint8)
    )
    length = dt / substeps
    ground = acceleration[0]
    write_slope(law, system, ground, work.state, work.stages[0])
    for sample in range(total):
        for fine in range(max(sample - 1, 0) * stride, sample * stride):
            i = fine // substeps
            rise = (acceleration[i + 1] - acceleration[i]) / substeps
            start = acceleration[i] + (fine - i * substeps) * rise
            ground = start + rise
            valid = valid and advance(law, system, omega, work, length, start, rise / length, refine)
        if not valid:
            history[:] = np.nan
            return history
        for q in range(quantities.size):
            for j in range(sensors.size):
                history[q, j, sample] = output_value(law, system, work, ground, quantities[q], sensors[j])
    return history


def nonlinear_histories(law, parameters, acceleration, dt, substeps, stride, sensors, quantities, refine=1):
    """Histories (quantity, sensor, time); `law` is a type of `restoring.LAWS`.

    Parameters
    ----------
    parameters : tuple of array
        Masses (n,) [kg], initial stiffnesses (n,) [N/m], Rayleigh pair (2,), damping ratios (n,), and the
        law's own (rows, n).
    """
    # copies: one compiled kernel for writable and read-only arrays
    *linear, values = (np.array(p, dtype=np.float64) for p in parameters)
    return history_kernel(
        law(values),
        *linear,
        np.array(acceleration, dtype=np.float64),
        float(dt),
        int(substeps),
        int(stride),
        np.array(sensors, dtype=np.int64),
        np.array(quantities, dtype=np.int64),
        int(refine),
    )


def nonlinear_response(law):
    """Return the response function of a law, as `simulators.FAMILIES` wants it."""

    def response(mass, stiffness, rayleigh, ratios, values, *settings):
        *where, n_modes, quantity = settings
        if n_modes != len(mass):
            raise ValueError(f"`n_modes` must be all {len(mass)} of a nonlinear chain, got {n_modes}.")
        parameters = (mass, stiffness, rayleigh, ratios, values)
        return nonlinear_histories(law, parameters, *where, [quantity])[0]

    return response
