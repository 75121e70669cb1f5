"""Response of a chain with nonlinear springs, for an excitation that is linear between its samples."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number, write_lanes
from pymc_features.simulators.nonlinear.law import LAWS, spring
from pymc_features.simulators.nonlinear.runge_kutta import advance
from pymc_features.simulators.nonlinear.state import (
    BRANCH,
    STIFFNESS,
    chain_memory,
    constant,
    deformation,
    padded,
    prepare,
    slope,
    state,
    write_slope,
)
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    QUANTITIES,
    RELATIVE_ACCELERATION,
    RELATIVE_VELOCITY,
    n_outputs,
)
from pymc_features.simulators.oscillators.recursion import check_sizes

# What else can be asked of a spring, after the codes of `QUANTITIES`
SPRING_FORCE, DRIFT, MEMORY = range(len(QUANTITIES), len(QUANTITIES) + 3)


@jit
def ground_at(acceleration, fine, substeps):
    """Ground acceleration [m/s^2] after `fine` steps, `substeps` to a sample of the record."""
    i = fine // substeps
    part = fine - i * substeps
    return acceleration[i] + (part * (acceleration[i + 1] - acceleration[i]) / substeps if part > 0 else 0.0)


@jit
def check_parameters(law, parameters, sensors, n_modes):
    """Refuse parameters whose sizes do not agree, and a reduced number of modes."""
    mass, stiffness, rayleigh, ratios, values = parameters
    check_sizes(mass, stiffness, rayleigh, ratios, sensors, mass.size)
    if mass.size != law.n or values.shape[1] != law.n:
        raise ValueError("the law of the springs must have one column for each spring")
    if n_modes != mass.size:
        raise ValueError("`n_modes` must be the number of degrees of freedom of a nonlinear chain")


@jit
def begin(law, acceleration, sampling, fine):
    """Write the slope of the state after `fine` steps; return the ground acceleration [m/s^2] there.

    `sampling`: dt, substeps, stride.
    """
    ground = ground_at(acceleration, fine, sampling[1])
    write_slope(law, ground, state(law, 0), slope(law, 0))
    return ground


@jit
def next_sample(law, acceleration, sampling, sample, tape):
    """Carry a state with its slope from output sample `sample` to the next; False where that fails.

    Depends on nothing but the state, so that it can be repeated from one.
    """
    dt, substeps, stride = sampling
    length = dt / substeps
    start = ground_at(acceleration, sample * stride, substeps)
    for fine in range(sample * stride, (sample + 1) * stride):
        trend = (ground_at(acceleration, fine + 1, substeps) - start) / length
        if not advance(law, length, start, trend, tape):
            return False
        start = begin(law, acceleration, sampling, fine + 1)
    return True


@jit
def write_outputs(law, ground, quantity, sensors, outputs):
    """Write one of `QUANTITIES` at the sensors; `outputs` (s,)."""
    p = law.rows * LANES
    first, rates = state(law, 0) * LANES, slope(law, 0) * LANES
    for j in range(sensors.size):
        if quantity == ABSOLUTE_ACCELERATION:
            outputs[j] = read_number(law.address, rates + p + sensors[j]) + ground
        elif quantity == RELATIVE_ACCELERATION:
            outputs[j] = read_number(law.address, rates + p + sensors[j])
        elif quantity == RELATIVE_VELOCITY:
            outputs[j] = read_number(law.address, first + p + sensors[j])
        else:
            outputs[j] = read_number(law.address, first + sensors[j])


@jit
def write_springs(law, quantity, springs, outputs):
    """Write what `QUANTITIES` does not name: force, drift or internal variable of springs; `outputs` (s,)."""
    here, target = state(law, 0), state(law, 1)  # a stage that no step needs any more
    for row in range(law.rows):
        drift, rate = deformation(law, here, row)
        value = memory = read_lanes(law.address, here + 2 * law.rows + row)
        if quantity == SPRING_FORCE:
            branch = constant(law, BRANCH, row)
            value = spring(law, row, constant(law, STIFFNESS, row), drift, rate, memory, branch)[0]
        elif quantity == DRIFT:
            value = drift
        write_lanes(law.address, target + row, value)
    for j in range(springs.size):
        outputs[j] = read_number(law.address, target * LANES + springs[j])


@jit
def history_kernel(law, parameters, acceleration, dt, substeps, stride, sensors, n_modes, quantities, refine):
    """Histories (quantity, sensor, time) of a chain whose springs follow `law`, at rest at first.

    `parameters` as of `spring_chain.prepare`, others as of `recursion.chain_response`; `quantities` are
    codes, and `refine` divides every step. All NaN where the parameters describe no structure or the
    integration fails.
    """
    check_parameters(law, parameters, sensors, n_modes)
    total = n_outputs(acceleration.size, substeps, stride)
    history = np.empty((quantities.size, sensors.size, total))
    outputs, sampling = np.empty(sensors.size), (dt, substeps, stride)
    valid = prepare(law, parameters, refine)
    begin(law, acceleration, sampling, 0)
    for sample in range(total):
        if sample > 0 and valid:
            valid = next_sample(law, acceleration, sampling, sample - 1, None)
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


def arguments(parameters, acceleration, dt, substeps, stride, sensors, n_modes):
    """Arguments of the kernels behind the law, in the types for which they are compiled."""
    # copies: one compiled kernel for writable and read-only arrays
    return (
        tuple(np.array(p, dtype=np.float64) for p in parameters),
        *(np.array(acceleration, dtype=np.float64), float(dt), int(substeps), int(stride)),
        *(np.array(sensors, dtype=np.int64), int(n_modes)),
    )


def in_memory(law, kernel, parameters, *others):
    """Call a kernel whose first argument is the law, with memory for a chain."""
    values, n = parameters[-1], parameters[0].shape[-1]
    if values.shape[-2] != LAWS[law].n_parameters:
        raise ValueError(f"the law must have {LAWS[law].n_parameters} rows, got {values.shape[-2]}.")
    memory = chain_memory(n)
    return kernel(law(memory.ctypes.data, padded(n) // LANES, n), parameters, *others)


def nonlinear_histories(law, parameters, excitation, sensors, quantities, refine=1):
    """Histories (quantity, sensor, time); `law` is a type of `restoring.LAWS`.

    Parameters
    ----------
    parameters : tuple of array
        Masses (n,) [kg], initial stiffnesses (n,) [N/m], Rayleigh pair (2,), damping ratios (n,), and the
        law's own (rows, n).
    """
    settings = (*excitation, sensors, len(parameters[0]))
    codes = np.array(quantities, dtype=np.int64)
    return in_memory(law, history_kernel, *arguments(parameters, *settings), codes, float(refine))


def nonlinear_response(law):
    """Return the response function of a law, as `simulators.FAMILIES` wants it."""

    def response(parameters, excitation, wanted):
        sensors, n_modes, quantity = wanted
        if n_modes != len(parameters[0]):
            raise ValueError(
                f"`n_modes` must be all {len(parameters[0])} of a nonlinear chain, got {n_modes}."
            )
        return nonlinear_histories(law, parameters, excitation, sensors, [quantity])[0]

    return response
