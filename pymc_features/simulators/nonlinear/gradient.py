"""Gradients of response and discrepancy of a nonlinear chain: the computed response, differentiated exactly.

A reverse sweep through the accepted steps. The response is kept as one state for each output sample; the
steps between two samples are repeated from there, recorded and differentiated in reverse, so that the memory
does not grow with the number of steps.

What a step's length depends on: the number of steps into which a segment is divided is a whole number, a
constant but where it jumps, and the response jumps there by no more than the error of the integration. Steps
that end at a kink have lengths that depend on the state, through the time of the kink; their derivatives are
included (`step_adjoint.remove_time`).

Against a tight solution the derivatives are right to 1e-8 ... 1e-7 of their peak (tests), for Bouc-Wen
springs with n = 1 to 1e-6 and with n = 1.2 to 4e-5: |z|^n is no smoother than that where z passes zero. One
gradient costs about six responses, whatever the number of parameters.
"""

import numpy as np
from numba import literal_unroll

from pymc_features.simulators.chain.modal_damping import add_damping_gradient, damping_coefficients
from pymc_features.simulators.chain.modes import chain_modes
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number, write_lanes, write_number
from pymc_features.simulators.nonlinear.discrepancy import check_observed, n_particles, particle
from pymc_features.simulators.nonlinear.response import begin, check_parameters, next_sample, write_outputs
from pymc_features.simulators.nonlinear.state import LAST, prepare, slope, state, write_slope
from pymc_features.simulators.nonlinear.step_adjoint import reverse_step, slope_adjoint
from pymc_features.simulators.nonlinear.step_tangent import (
    OF_DASHPOT,
    OF_MASS,
    OF_MODAL,
    OF_STIFFNESS,
    of_slope,
    of_state,
)
from pymc_features.simulators.nonlinear.tape import CAPACITY, NEVER, read_tape, recorded, rewind
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY, n_outputs


@jit
def save(law, kept):
    """Copy the present state into an array (3 p,)."""
    for i in range(kept.size):
        kept[i] = read_number(law.address, state(law, 0) * LANES + i)


@jit
def restore(law, kept):
    """Make a copied state the present one."""
    for i in range(kept.size):
        write_number(law.address, state(law, 0) * LANES + i, kept[i])


@jit
def add_output(law, work, quantity, sensors, cotangent, ground):
    """Add the gradient by the outputs at a sample to that by the state, which is the present one."""
    p = law.rows * LANES
    for row in range(3 * law.rows):
        write_lanes(work, of_slope(law, 0) + row, splat(0.0))
        write_lanes(work, of_state(law, 0) + row, splat(0.0))
    of_output = quantity in (RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY)
    first = (of_state(law, 0) if of_output else of_slope(law, 0)) * LANES
    if quantity != RELATIVE_DISPLACEMENT:
        first += p
    for j in range(sensors.size):
        i = first + sensors[j]
        write_number(work, i, read_number(work, i) + cotangent[j])
    if not of_output:
        slope_adjoint(law, work, 0, 1.0, ground)
    for row in range(3 * law.rows):
        here = of_state(law, LAST) + row
        write_lanes(work, here, read_lanes(work, here) + read_lanes(work, of_state(law, 0) + row))


@jit
def record(law, tape, acceleration, sampling, kept, sample, first):
    """March from an output sample, state `kept`, to the next; steps from `first` on go to the tape.

    Returns whether it succeeds, the number of steps, and the number of those on the tape.
    """
    restore(law, kept)
    begin(law, acceleration, sampling, sample * sampling[2])
    rewind(tape, first)
    valid = next_sample(law, acceleration, sampling, sample, tape)
    return valid, *recorded(tape)


@jit
def reverse_sample(law, work, tape, acceleration, sampling, kept, sample):
    """Carry the gradient back over the steps between an output sample and the next."""
    first, by_time = 0, 0.0
    _, count, size = record(law, tape, acceleration, sampling, kept, sample, first)
    if count > CAPACITY:
        first = (count - 1) // CAPACITY * CAPACITY
        _, _, size = record(law, tape, acceleration, sampling, kept, sample, first)
    while True:
        for index in range(size - 1, -1, -1):
            step, ground, trend, which = read_tape(law, tape, index)
            write_slope(law, ground, state(law, 0), slope(law, 0))
            by_time = reverse_step(law, work, step, ground, trend, which, by_time)
        if first == 0:
            return
        first -= CAPACITY
        _, _, size = record(law, tape, acceleration, sampling, kept, sample, first)


@jit
def collect(law, work, parameters, gradients):
    """Add to the gradients what the sweep has summed up."""
    mass, stiffness, rayleigh, ratios, _ = parameters
    d_mass, d_stiffness, d_rayleigh, d_ratios, d_values = gradients
    n, p = law.n, law.rows * LANES
    omega, participation, shapes = np.empty(n), np.empty(n), np.empty((n, n))
    chain_modes(mass, stiffness, omega, shapes, participation)
    cotangent = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            cotangent[i, j] = read_number(work, (OF_MODAL + j) * p + i)
    matrix = damping_coefficients(mass, omega, shapes, ratios)
    for i in range(n):
        inertia = read_number(work, OF_MASS * p + i)
        for j in range(n):
            inertia -= matrix[i, j] * cotangent[i, j]
        by_dashpot = read_number(work, OF_DASHPOT * p + i)
        d_mass[i] -= inertia / mass[i]
        d_stiffness[i] += read_number(work, OF_STIFFNESS * p + i) + rayleigh[1] * by_dashpot
        d_rayleigh[0] += cotangent[i, i]
        d_rayleigh[1] += stiffness[i] * by_dashpot
        for k in range(d_values.shape[0]):
            d_values[k, i] += read_number(work, k * p + i)
    add_damping_gradient(mass, omega, shapes, ratios, cotangent, (d_mass, d_stiffness, d_ratios))


@jit
def add_gradient(
    law, work, tape, parameters, acceleration, sampling, sensors, quantity, history, weights, gradients
):
    """Add the gradient for one set of parameters to `gradients`; NaN where there is no response.

    `history` (s, u) is the cotangent of the response or, if there are `weights` (s,), the data.
    """
    total = history.shape[1]
    states = np.empty((total, 3 * law.rows * LANES))
    valid = prepare(law, parameters, 1.0)
    rewind(tape, NEVER)
    begin(law, acceleration, sampling, 0)
    for sample in range(total):
        if sample > 0 and valid:
            valid = next_sample(law, acceleration, sampling, sample - 1, tape)
        if not valid:
            for gradient in literal_unroll(gradients):
                gradient[:] = np.nan
            return
        save(law, states[sample])
    for i in range((OF_MODAL + law.n) * law.rows * LANES):
        write_number(work, i, 0.0)
    outputs = np.empty(sensors.size)
    for sample in range(total - 1, -1, -1):
        restore(law, states[sample])
        ground = begin(law, acceleration, sampling, sample * sampling[2])
        if weights.size:
            write_outputs(law, ground, quantity, sensors, outputs)
            for j in range(sensors.size):
                outputs[j] = 2.0 * weights[j] / total * (outputs[j] - history[j, sample])
        else:
            outputs[:] = history[:, sample]
        add_output(law, work, quantity, sensors, outputs, ground)
        if sample > 0:
            reverse_sample(law, work, tape, acceleration, sampling, states[sample - 1], sample - 1)
    collect(law, work, parameters, gradients)


@jit
def gradient_kernel(
    law,
    parameters,
    acceleration,
    dt,
    substeps,
    stride,
    sensors,
    n_modes,
    quantity,
    history,
    weights,
    work,
    tape,
):
    """As `gradient.population_gradient`, with `history` the data and `weights` (p, s).

    With `weights` (p, 0) `history` is the cotangent of the response instead, as in
    `gradient.response_gradient`. `work`, `tape`: memory for derivatives and steps.
    """
    check_parameters(law, particle(parameters, 0), sensors, n_modes)
    check_observed(history, sensors, n_outputs(acceleration.size, substeps, stride))
    if weights.shape[0] != n_particles(parameters) or weights.shape[1] not in (0, sensors.size):
        raise ValueError("`weights` must have the shape (particle, sensor)")
    mass, stiffness, rayleigh, ratios, values = parameters
    gradients = (
        *(np.zeros(mass.shape), np.zeros(stiffness.shape), np.zeros(rayleigh.shape)),
        *(np.zeros(ratios.shape), np.zeros(values.shape)),
    )
    for k in range(weights.shape[0]):
        add_gradient(
            *(law, work, tape, particle(parameters, k), acceleration, (dt, substeps, stride)),
            *(sensors, quantity, history, weights[k], particle(gradients, k)),
        )
    return gradients
