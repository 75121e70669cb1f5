"""Gradient of the response of a nonlinear chain: the steps of the integration, differentiated in reverse.

A sweep through the accepted steps, from the last to the first. The state at each output sample is kept; the
steps between two samples are repeated from there, recorded and differentiated in reverse, so that the memory
does not grow with the number of steps.

The number of steps per segment is piecewise constant and contributes no derivative; where it jumps, the
response jumps by no more than the error of the integration. Steps that end at a kink have lengths that depend
on the state, through the time of the kink; their derivatives are included (`kink_adjoint`).

Against a tight solution the derivatives are right to 1e-8 ... 1e-7 of their peak (tests), for Bouc-Wen
springs with n = 1 to 1e-6 and with n = 1.2 to 4e-5: |z|^n is no smoother than that where z passes zero. One
gradient costs about six responses, whatever the number of parameters; with damping by modal ratios more, for
the gradient by the n x n damping matrix. Without it, where all ratios have the least value that they can
have, zero, the gradient by them is not computed: it is NaN.
"""

import numpy as np

from pymc_features.simulators.chain.modal_damping import add_damping_gradient, damping_coefficients
from pymc_features.simulators.chain.modes import chain_modes
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number, write_lanes, write_number
from pymc_features.simulators.nonlinear.layout import (
    DASHPOT,
    INVERSE_MASS,
    LAST,
    MASS_DAMPING,
    MODAL_DAMPING,
    STIFFNESS,
    restore_state,
    slope,
    state,
)
from pymc_features.simulators.nonlinear.parameters import NonlinearParameters
from pymc_features.simulators.nonlinear.response import begin, next_sample, output_block
from pymc_features.simulators.nonlinear.state import has_modal_damping, prepare, write_slope
from pymc_features.simulators.nonlinear.step_adjoint import reverse_step, slope_adjoint
from pymc_features.simulators.nonlinear.tape import CAPACITY, read_tape, recorded, rewind
from pymc_features.simulators.oscillators.arguments import ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION


@jit
def output_adjoint(law, grad, wanted, cotangent, ground):
    """Add the gradient by the outputs (s,) of the present state, through stage 0, to that by the state."""
    for row in range(3 * law.rows):
        write_lanes(grad, slope(law, 0) + row, splat(0.0))
        write_lanes(grad, state(law, 0) + row, splat(0.0))
    first = output_block(law, wanted.quantity)
    for j in range(wanted.sensors.size):
        i = first + wanted.sensors[j]
        write_number(grad, i, read_number(grad, i) + cotangent[j])
    if wanted.quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION):  # part of the slope
        slope_adjoint(law, grad, 0, ground)
    for row in range(3 * law.rows):
        here = state(law, LAST) + row
        write_lanes(grad, here, read_lanes(grad, here) + read_lanes(grad, state(law, 0) + row))


@jit
def record(law, tape, excitation, kept, sample, first):
    """March from an output sample, state `kept`, to the next; steps from number `first` on go to the tape.

    Returns the number of steps, and of those on the tape.
    """
    restore_state(law, kept)
    begin(law, excitation, sample * excitation.stride)
    rewind(tape, first)
    next_sample(law, excitation, sample, tape)
    return recorded(tape)


@jit
def reverse_sample(law, grad, tape, excitation, kept, sample):
    """Carry the gradient back over the steps between an output sample and the next."""
    first, grad_time = 0, 0.0
    count, size = record(law, tape, excitation, kept, sample, first)
    if count > CAPACITY:  # the last steps first
        first = (count - 1) // CAPACITY * CAPACITY
        _, size = record(law, tape, excitation, kept, sample, first)
    while True:
        for index in range(size - 1, -1, -1):
            step, ground, trend, which = read_tape(law, tape, index)
            write_slope(law, ground, state(law, 0), slope(law, 0))
            grad_time = reverse_step(law, grad, (step, ground, trend, which), grad_time)
        if first == 0:
            return
        first -= CAPACITY
        _, size = record(law, tape, excitation, kept, sample, first)


@jit
def collect_modal_damping(law, grad, parameters, gradients):
    """Add what the gradient by M^-1 C of modal ratios gives those by mass, stiffness and ratios."""
    mass, stiffness, _, ratios, _ = parameters
    n, p = law.n, law.rows * LANES
    omega, participation, shapes = np.empty(n), np.empty(n), np.empty((n, n))
    chain_modes(mass, stiffness, omega, shapes, participation)
    grad_damping = np.empty((n, n))  # by M^-1 C
    matrix = damping_coefficients(mass, omega, shapes, ratios)
    for i in range(n):
        for j in range(n):
            grad_damping[i, j] = read_number(grad, (MODAL_DAMPING + j) * p + i)
            # the springs' part of the acceleration is that without modal damping
            gradients[0][i] += matrix[i, j] * grad_damping[i, j] / mass[i]
    add_damping_gradient(mass, omega, shapes, ratios, grad_damping, gradients)


@jit
def collect(law, grad, parameters):
    """Gradients by the parameters, from what the sweep has summed up."""
    mass, stiffness, rayleigh, ratios, values = parameters
    n, p = law.n, law.rows * LANES
    grad_mass, grad_stiffness, grad_rayleigh = np.empty(n), np.empty(n), np.zeros(2)
    grad_ratios, grad_values = np.zeros(n), np.empty(values.shape)
    for i in range(n):
        # d(1/m) / (1/m) = -dm / m; the dashpot of a spring is beta k
        grad_mass[i] = -read_number(grad, INVERSE_MASS * p + i) / mass[i]
        grad_dashpot = read_number(grad, DASHPOT * p + i)
        grad_stiffness[i] = read_number(grad, STIFFNESS * p + i) + rayleigh[1] * grad_dashpot
        grad_rayleigh[0] += read_number(grad, MASS_DAMPING * p + i)
        grad_rayleigh[1] += stiffness[i] * grad_dashpot
        for k in range(values.shape[0]):
            grad_values[k, i] = read_number(grad, k * p + i)
    if has_modal_damping(law):
        collect_modal_damping(law, grad, parameters, (grad_mass, grad_stiffness, grad_ratios))
    else:
        grad_ratios[:] = np.nan
    return NonlinearParameters(grad_mass, grad_stiffness, grad_rayleigh, grad_ratios, grad_values)


@jit
def gradient_kernel(law, grad, tape, parameters, excitation, wanted, states, cotangent):
    """Gradient of sum_jk W_jk y_jk by the parameters of one chain.

    `grad` is the address of the gradient's memory; `states` (u, 3 p) those of `history_kernel`
    and `cotangent` W (s, u).
    """
    prepare(law, parameters, 1.0)
    columns = law.n if has_modal_damping(law) else 0
    for row in range((MODAL_DAMPING + columns) * law.rows):
        write_lanes(grad, row, splat(0.0))
    for sample in range(states.shape[0] - 1, -1, -1):
        restore_state(law, states[sample])
        ground = begin(law, excitation, sample * excitation.stride)
        output_adjoint(law, grad, wanted, cotangent[:, sample], ground)
        if sample > 0:
            reverse_sample(law, grad, tape, excitation, states[sample - 1], sample - 1)
    return collect(law, grad, parameters)
