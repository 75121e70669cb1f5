"""Derivatives of response and discrepancy of a nonlinear chain along a direction.

The derivative goes through the steps of `nonlinear_gradient.py`, forward: its transpose, to rounding.
"""

import numpy as np

from pymc_features.simulators.chain.modal_damping import damping_tangent
from pymc_features.simulators.chain.modes import chain_modes
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import read_number, write_number
from pymc_features.simulators.nonlinear.discrepancy import check_observed
from pymc_features.simulators.nonlinear.gradient import record, restore, save
from pymc_features.simulators.nonlinear.kinks import kink_function
from pymc_features.simulators.nonlinear.response import begin, check_parameters, write_outputs
from pymc_features.simulators.nonlinear.runge_kutta import try_step
from pymc_features.simulators.nonlinear.state import LAST, prepare, put, slope, state, write_slope
from pymc_features.simulators.nonlinear.step_tangent import (
    CARRY,
    OF_DASHPOT,
    OF_DRAG,
    OF_MASS,
    OF_MODAL,
    OF_STIFFNESS,
    add_multiple,
    length_tangent,
    move,
    of_slope,
    of_state,
    slope_tangent,
    step_tangent,
)
from pymc_features.simulators.nonlinear.tape import CAPACITY, read_tape
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY, n_outputs


@jit
def put_direction(law, work, parameters, directions):
    """Write the directions of the parameters, and that of the state at rest."""
    mass, stiffness, rayleigh, ratios, _ = parameters
    d_mass, d_stiffness, d_rayleigh, d_ratios, d_values = directions
    rows, n = law.rows, law.n
    for i in range((OF_MODAL + n) * rows * LANES):
        write_number(work, i, 0.0)
    omega, participation, shapes = np.empty(n), np.empty(n), np.empty((n, n))
    chain_modes(mass, stiffness, omega, shapes, participation)
    matrix = damping_tangent(mass, omega, shapes, ratios, (d_mass, d_stiffness, d_ratios))
    for i in range(n):
        for k in range(d_values.shape[0]):
            put(work, rows, k, i, d_values[k, i])
        put(work, rows, OF_STIFFNESS, i, d_stiffness[i])
        put(work, rows, OF_MASS, i, -d_mass[i] / (mass[i] * mass[i]))
        put(work, rows, OF_DASHPOT, i, d_rayleigh[1] * stiffness[i] + rayleigh[1] * d_stiffness[i])
        put(work, rows, OF_DRAG, i, d_rayleigh[0])
        for j in range(n):
            put(work, rows, OF_MODAL + j, i, matrix[i, j])


@jit
def forward_step(law, work, step, ground, trend, which, of_time):
    """Carry the derivative of the state over an accepted step; return that of the time of its end.

    Arguments as of `step_adjoint.reverse_step`; `of_time` is the derivative of the time of its start.
    """
    try_step(law, step, ground, trend)
    move(law, work, CARRY * law.rows, of_state(law, 0), 1.0)
    step_tangent(law, work, step, trend, 0.0 if which >= 0 else -of_time, trend * of_time, 1.0)
    move(law, work, of_state(law, LAST), CARRY * law.rows, 1.0)
    if which < 0:
        return 0.0
    of_kink = kink_function(law, work, of_state(law, LAST), which)
    length_tangent(law, work, step, trend)
    of_step = -of_kink / kink_function(law, work, of_state(law, LAST), which)
    add_multiple(law, work, of_state(law, LAST), CARRY * law.rows, of_step)
    return of_time + of_step


@jit
def forward_sample(law, work, tape, acceleration, sampling, start, end, sample):
    """Carry state and derivative from an output sample to the next; both states are kept, (3 p,) each."""
    first, of_time = 0, 0.0
    save(law, start)
    while True:
        valid, count, size = record(law, tape, acceleration, sampling, start, sample, first)
        if not valid:
            return False
        save(law, end)
        for index in range(size):
            step, ground, trend, which = read_tape(law, tape, index)
            write_slope(law, ground, state(law, 0), slope(law, 0))
            of_time = forward_step(law, work, step, ground, trend, which, of_time)
        first += CAPACITY
        if first >= count:
            restore(law, end)
            return True


@jit
def write_output_tangent(law, work, quantity, sensors, outputs):
    """Write the derivative of the outputs at a sample, whose state, with its slope, is the present one."""
    move(law, work, CARRY * law.rows, of_state(law, 0), 1.0)
    slope_tangent(law, work, 0, 0.0, 1.0)
    p = law.rows * LANES
    first = of_slope(law, 0) * LANES + p
    if quantity == RELATIVE_DISPLACEMENT:
        first = of_state(law, 0) * LANES
    elif quantity == RELATIVE_VELOCITY:
        first = of_state(law, 0) * LANES + p
    for j in range(sensors.size):
        outputs[j] = read_number(work, first + sensors[j])


@jit
def march_tangent(
    law,
    work,
    tape,
    parameters,
    directions,
    acceleration,
    sampling,
    sensors,
    quantity,
    observed,
    history,
    sums,
):
    """Write the derivative of the response into `history` (s, u) or, if empty, of e_j into `sums` (s,)."""
    total = n_outputs(acceleration.size, sampling[1], sampling[2])
    start, end = np.empty(3 * law.rows * LANES), np.empty(3 * law.rows * LANES)
    outputs, changes = np.empty(sensors.size), np.empty(sensors.size)
    valid = prepare(law, parameters, 1.0)
    if valid:
        put_direction(law, work, parameters, directions)
    for sample in range(total):
        if sample > 0 and valid:
            valid = forward_sample(law, work, tape, acceleration, sampling, start, end, sample - 1)
        if not valid:
            history[:], sums[:] = np.nan, np.nan
            return
        ground = begin(law, acceleration, sampling, sample * sampling[2])
        write_output_tangent(law, work, quantity, sensors, changes)
        if history.size:
            history[:, sample] = changes
        else:
            write_outputs(law, ground, quantity, sensors, outputs)
            for j in range(sensors.size):
                sums[j] += 2.0 / total * (outputs[j] - observed[j, sample]) * changes[j]


@jit
def check_directions(parameters, directions):
    """Refuse directions of other shapes than the parameters'."""
    mass, stiffness, rayleigh, ratios, values = parameters
    d_mass, d_stiffness, d_rayleigh, d_ratios, d_values = directions
    same = d_mass.shape == mass.shape and d_stiffness.shape == stiffness.shape
    same = same and d_rayleigh.shape == rayleigh.shape and d_ratios.shape == ratios.shape
    if not (same and d_values.shape == values.shape):
        raise ValueError("the directions must have the shapes of the parameters")


@jit
def tangent_kernel(
    law,
    parameters,
    acceleration,
    dt,
    substeps,
    stride,
    sensors,
    n_modes,
    quantity,
    observed,
    directions,
    work,
    tape,
):
    """As `tangent.response_tangent` or, if `observed` is not empty, (s, 1) as `tangent.discrepancy_tangent`.

    `work`, `tape`: memory for derivatives and steps.
    """
    check_parameters(law, parameters, sensors, n_modes)
    check_directions(parameters, directions)
    total = n_outputs(acceleration.size, substeps, stride)
    history, sums = np.empty((sensors.size, 0)), np.zeros(sensors.size)
    if observed.size:
        check_observed(observed, sensors, total)
    else:
        history = np.empty((sensors.size, total))
    march_tangent(
        *(law, work, tape, parameters, directions, acceleration, (dt, substeps, stride)),
        *(sensors, quantity, observed, history, sums),
    )
    return sums.reshape(-1, 1) if observed.size else history
