"""Histories of a chain with nonlinear springs by Runge-Kutta steps; Taylor steps as Python calls them."""

import numpy as np
from numba.extending import overload

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.nonlinear.law import (
    BRANCH,
    SERIES,
    STIFFNESS,
    constant,
    slope,
    spring,
    state,
)
from pymc_features.simulators.nonlinear.runge_kutta import advance
from pymc_features.simulators.nonlinear.state import deformation, prepare, write_slope
from pymc_features.simulators.numbers.vectors import LANES, load, read_number, store
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    QUANTITIES,
    RELATIVE_DISPLACEMENT,
    RELATIVE_VELOCITY,
    ground_at,
    n_outputs,
)
from pymc_features.simulators.taylor.adjoint.sweep import sweep_of
from pymc_features.simulators.taylor.march import march_of

# What else can be asked of a spring, after the codes of `QUANTITIES`
SPRING_FORCE, DRIFT, INTERNAL_VARIABLE = range(len(QUANTITIES), len(QUANTITIES) + 3)


@jit
def begin(law, excitation, fine):
    """Write the slope of the state after `fine` steps; return the ground acceleration [m/s^2] there."""
    ground = ground_at(excitation.acceleration, fine, excitation.substeps)
    write_slope(law, ground, state(law, 0), slope(law, 0))
    return ground


@jit
def next_sample(law, excitation, sample):
    """Carry a state with its slope from output sample `sample` to the next; False where that fails.

    Depends on nothing but the state.
    """
    acceleration, dt, substeps, stride, _ = excitation
    length = dt / substeps
    start = ground_at(acceleration, sample * stride, substeps)
    for fine in range(sample * stride, (sample + 1) * stride):
        trend = (ground_at(acceleration, fine + 1, substeps) - start) / length
        if not advance(law, length, start, trend):
            return False
        start = begin(law, excitation, fine + 1)
    return True


@jit
def output_block(law, quantity):
    """First number of a quantity, relative to the ground, in the present state or its slope."""
    if quantity == RELATIVE_DISPLACEMENT:
        return state(law, 0) * LANES
    if quantity == RELATIVE_VELOCITY:
        return (state(law, 0) + law.rows) * LANES
    return (slope(law, 0) + law.rows) * LANES


@jit
def write_outputs(law, ground, quantity, sensors, outputs):
    """Write one of `QUANTITIES` at the sensors; `outputs` (s,)."""
    first = output_block(law, quantity)
    support = ground if quantity == ABSOLUTE_ACCELERATION else 0.0
    for j in range(sensors.size):
        outputs[j] = read_number(law.address, first + sensors[j]) + support


@jit
def write_springs(law, quantity, springs, outputs):
    """Write force, drift or internal variable of springs; `outputs` (s,)."""
    here, target = state(law, 0), state(law, 1)  # a stage that no step needs any more
    for row in range(law.rows):
        drift, rate = deformation(law, here, row)
        value = z = load(law.address, here + 2 * law.rows + row)
        if quantity == SPRING_FORCE:
            branch = constant(law, BRANCH, row)
            value = spring(law, row, constant(law, STIFFNESS, row), drift, rate, z, branch)[0]
        elif quantity == DRIFT:
            value = drift
        store(law.address, target + row, value)
    for j in range(springs.size):
        outputs[j] = read_number(law.address, target * LANES + springs[j])


@jit
def history_kernel(law, parameters, excitation, sensors, quantities, refine):
    """Histories (quantity, sensor, time) of a chain whose springs follow `law`, at rest at first.

    `quantities` are codes and `refine` divides every step. All NaN where the parameters describe no structure
    or the integration fails.
    """
    acceleration, _, substeps, stride, _ = excitation
    total = n_outputs(acceleration.size, substeps, stride)
    history = np.empty((quantities.size, sensors.size, total))
    outputs = np.empty(sensors.size)
    valid = prepare(law, parameters, refine)
    begin(law, excitation, 0)
    for sample in range(total):
        if sample > 0 and valid:
            valid = next_sample(law, excitation, sample - 1)
        if not valid:
            history[:] = np.nan
            return history
        ground = ground_at(acceleration, sample * stride, substeps)
        for q in range(quantities.size):
            if quantities[q] < SPRING_FORCE:
                write_outputs(law, ground, quantities[q], sensors, outputs)
            else:
                write_springs(law, quantities[q], sensors, outputs)
            history[q, :, sample] = outputs
    return history


def march(group, batch, sums, start, spans, wanted, observed, tape):
    """March a group by the recurrence of its type; see `taylor.march`."""


@overload(march, inline="always")
def _march(group, batch, sums, start, spans, wanted, observed, tape):
    own = march_of(SERIES[group.instance_class])

    def of_type(group, batch, sums, start, spans, wanted, observed, tape):
        return own(group, batch, sums, start, spans, wanted, observed, tape)

    return of_type


@jit
def march_kernel(group, batch, sums, start, spans, wanted, observed, tape):
    """`march` as Python calls it: Taylor steps of a chain in each lane."""
    return march(group, batch, sums, start, spans, wanted, observed, tape)


def sweep(group, memory, tape, spans, wanted, observed):
    """Take a group back through its march by the recurrence of its type; see `taylor.adjoint.sweep`."""


@overload(sweep, inline="always")
def _sweep(group, memory, tape, spans, wanted, observed):
    own = sweep_of(SERIES[group.instance_class])

    def of_type(group, memory, tape, spans, wanted, observed):
        return own(group, memory, tape, spans, wanted, observed)

    return of_type


@jit
def sweep_kernel(group, memory, tape, spans, wanted, observed):
    """`sweep` as Python calls it: the march of a chain in each lane, in reverse."""
    return sweep(group, memory, tape, spans, wanted, observed)
