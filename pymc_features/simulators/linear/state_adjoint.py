"""Gradients and tangents of coupled modes: the adjoint of the recursion of `state_space`.

With z[k+1] = T z[k] + N a[k] + A a[k+1] and y[k] = O z[k] + J a[k], the derivatives of L by the states are

    mu[k] = T' mu[k+1] + O' w[k],   w = dL/dy,

and those by T, N, A, O and J are sums of products of mu, w, z and a. The states are computed again from
checkpoints, 128 steps at a time. The derivatives of the matrix exponential follow from its Frechet
derivative (Al-Mohy & Higham, SIAM J. Matrix Anal. Appl. 30, 1639-1657, 2009).

The modes are a basis Phi that is held fixed: the response does not depend on it, so that repeated frequencies
need no care. Its modal equations have Omega^2 = X^-1 Phi' K Phi, D = X^-1 Phi' C Phi and Gamma = X^-1 Phi' L,
X = Phi' M Phi, which is the identity before any change.
"""

import numpy as np
from scipy.linalg import expm_frechet

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.linear.projection import Cotangent
from pymc_features.simulators.linear.state_space import (
    StateMatrices,
    advance_state,
    block_samples,
    generator,
    output_matrix,
    outputs_of,
    state_matrices,
)
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY
from pymc_features.simulators.oscillators.misfit import take_change, weigh_history


@jit
def checkpoints(matrices, excitation, response):
    """States (blocks, 2 m) at the first sample of each block; the outputs go into `response` (s, u)."""
    (size, n_inputs), stride, total = matrices.now.shape, excitation.stride, response.shape[1]
    samples = block_samples(stride)
    n_blocks = (total + samples - 1) // samples
    starts = np.zeros((n_blocks, size))
    states, ground = np.zeros((samples * stride + 1, size)), np.zeros((n_inputs, samples * stride + 1))
    for block in range(n_blocks):
        first = block * samples
        count = min(samples, total - first)
        steps = count * stride if block + 1 < n_blocks else (count - 1) * stride
        states[0] = starts[block]
        advance_state(matrices, excitation, first * stride, steps, states, ground)
        response[:, first : first + count] = outputs_of(matrices, states, ground, count, stride)
        if block + 1 < n_blocks:
            starts[block + 1] = states[steps]
    return starts


@jit
def matrix_gradients(matrices, excitation, starts, weighted):
    """Derivatives of L by all of `StateMatrices`.

    Parameters
    ----------
    matrices : StateMatrices
    excitation : Excitation
    starts : array (blocks, 2 m)
        States from `checkpoints`.
    weighted : array (s, u)
        w = dL/dy.
    """
    (size, n_inputs), stride, total = matrices.now.shape, excitation.stride, weighted.shape[1]
    samples = block_samples(stride)
    states, ground = np.zeros((samples * stride + 1, size)), np.zeros((n_inputs, samples * stride + 1))
    adjoints, backward = np.zeros((samples * stride + 1, size)), np.ascontiguousarray(matrices.transition.T)
    grad_transition, grad_output = np.zeros((size, size)), np.zeros(matrices.output.shape)
    grad_now, grad_after = np.zeros((size, n_inputs)), np.zeros((size, n_inputs))
    grad_direct = np.zeros(matrices.direct.shape)
    for block in range(starts.shape[0] - 1, -1, -1):
        first = block * samples
        count = min(samples, total - first)
        is_last = block + 1 == starts.shape[0]
        steps = (count - 1) * stride if is_last else count * stride
        states[0] = starts[block]
        advance_state(matrices, excitation, first * stride, steps, states, ground)
        own = np.ascontiguousarray(weighted[:, first : first + count])
        grad_output += np.dot(own, np.ascontiguousarray(states[: count * stride : stride]))
        grad_direct += np.dot(own, np.ascontiguousarray(ground[:, : count * stride : stride].T))
        loads = np.dot(own.T, matrices.output)  # O' w
        # the adjoint of the state at the block's end is the first of the block behind it
        adjoints[steps] = loads[count - 1] if is_last else adjoints[0]
        for b in range(steps - 1, -1, -1):
            np.dot(backward, adjoints[b + 1], adjoints[b])
            if b % stride == 0:
                adjoints[b] += loads[b // stride]
        following = np.ascontiguousarray(adjoints[1 : steps + 1].T)
        grad_transition += np.dot(following, states[:steps])
        grad_now += np.dot(following, np.ascontiguousarray(ground[:, :steps].T))
        grad_after += np.dot(following, np.ascontiguousarray(ground[:, 1 : steps + 1].T))
    return StateMatrices(grad_transition, grad_now, grad_after, grad_output, grad_direct)


@jit
def march_state_change(matrices, excitation, observed, history, sums):
    """Carry the response and its change through the record; see `take_change` for what becomes of them.

    The matrices are those of states beside their changes; the outputs likewise, the response first.
    """
    (size, n_inputs), stride = matrices.now.shape, excitation.stride
    n_sensors, total = matrices.direct.shape[0] // 2, max(history.shape[1], observed.shape[1])
    samples = block_samples(stride)
    states, ground = np.zeros((samples * stride + 1, size)), np.zeros((n_inputs, samples * stride + 1))
    for first in range(0, total, samples):
        count = min(samples, total - first)
        steps = count * stride if first + count < total else (count - 1) * stride
        advance_state(matrices, excitation, first * stride, steps, states, ground)
        both = np.ascontiguousarray(outputs_of(matrices, states, ground, count, stride).T)
        take_change(both[:, :n_sensors], both[:, n_sensors:], first, observed, history, sums)
        states[0] = states[steps]


def pull_back(a, system, history, weights=None):
    """Derivatives of a number L, see `Cotangent`.

    Parameters
    ----------
    a : Arguments
    system : System
    history : array (s, u)
        The weights w of L = sum w y or, if there are `weights`, the data.
    weights : array (s, 1) or (s, 4), optional
        c of L = sum c times the statistics of the misfit, see `oscillators.misfit`.

    Notes
    -----
    Memory: the response of this one structure, and the states at every 128th step.
    """
    (m, d), step, omega, D = system.participation.shape, a.step, system.omega, system.modal_damping
    matrices = state_matrices(a, system)
    weighted = np.empty(a.shape)
    starts = checkpoints(matrices, a.inputs, weighted)
    if weights is None:
        weighted = writable(history)
    else:
        weigh_history(weighted, writable(history), writable(weights))
    grad = matrix_gradients(matrices, a.inputs, starts, weighted)

    # the exponential E of the generator B: E_2 = N + A and E_3 = A stand beside T, and
    # B has the rows [-(Omega h)^2 / S, -D h, -h^2 Gamma]
    matrix, scale = generator(omega, D, system.participation, step)
    grad_exponential = np.zeros_like(matrix)
    grad_exponential[: 2 * m] = np.hstack([grad.transition, grad.now, grad.after - grad.now])
    grad_generator = expm_frechet(matrix.T, grad_exponential, compute_expm=False)[m : 2 * m]
    grad_spring = -(step**2) * grad_generator[:, :m] / scale  # by Omega^2, D and Gamma
    grad_damping = -step * grad_generator[:, m : 2 * m]
    grad_participation = -(step**2) * grad_generator[:, 2 * m : 2 * m + d]

    # outputs, by what stands before q and q': S Phi, or -S Phi (Omega^2 q + D q' + Gamma a)
    grad_q, grad_velocity = grad.output[:, :m] / scale, grad.output[:, m:] / step
    if a.wanted.quantity == RELATIVE_DISPLACEMENT:
        grad_output_shapes = grad_q
    elif a.wanted.quantity == RELATIVE_VELOCITY:
        grad_output_shapes = grad_velocity
    else:
        grad_output_shapes = -grad_q * omega**2 - grad_velocity @ D.T - grad.direct @ system.participation.T
        output_shapes = a.wanted.sensors @ system.shapes
        grad_spring -= output_shapes.T @ grad_q
        grad_damping -= output_shapes.T @ grad_velocity
        grad_participation -= output_shapes.T @ grad.direct

    # by X = Phi' M Phi, which divides all three, and by Phi outside its span
    grad_mass = -(grad_damping @ D.T + grad_spring * omega**2 + grad_participation @ system.participation.T)
    shapes, damping = system.shapes, system.damping
    grad_shapes = a.wanted.sensors.T @ grad_output_shapes + system.load @ grad_participation.T
    grad_shapes += (damping @ shapes) @ grad_damping.T + damping.T @ (shapes @ grad_damping)
    return Cotangent(
        stiffness=grad_spring,
        mass=grad_mass,
        damping=grad_damping,
        load=grad_participation,
        shapes=grad_shapes,
        rayleigh=np.zeros(2),
        ratios=np.zeros(a.parameters.ratios.size),
    )


def push_forward(a, system, change, directions, observed, history):
    """As `oscillators.push_forward`; with a matrix for damping nothing depends on the `directions`."""
    (m, d), step = system.participation.shape, a.step
    shapes, square, D = system.shapes, system.omega**2, system.modal_damping
    # changes of Omega^2, D and Gamma, with X and Phi outside its span
    d_spring = change.stiffness - change.mass * square
    d_damping = change.damping - change.mass @ D
    d_damping += change.shapes.T @ (system.damping @ shapes) + (shapes.T @ system.damping) @ change.shapes
    d_participation = change.load + change.shapes.T @ system.load - change.mass @ system.participation

    # changes of T, N and A, from that of the generator's exponential
    matrix, scale = generator(system.omega, D, system.participation, step)
    d_matrix = np.zeros_like(matrix)
    d_matrix[m : 2 * m, :m] = -step * step * d_spring / scale
    d_matrix[m : 2 * m, m : 2 * m] = -step * d_damping
    d_matrix[m : 2 * m, 2 * m : 2 * m + d] = -step * step * d_participation
    d_exponential = expm_frechet(matrix, d_matrix, compute_expm=False)[: 2 * m]
    d_transition, d_after = d_exponential[:, : 2 * m], d_exponential[:, 2 * m + d :]
    d_now = d_exponential[:, 2 * m : 2 * m + d] - d_after

    # changes of O and J: of S Phi, and for accelerations of what it multiplies
    output_shapes = a.wanted.sensors @ system.shapes
    d_output_shapes, quantity = a.wanted.sensors @ change.shapes, a.wanted.quantity
    d_output = output_matrix(system.omega, D, d_output_shapes, step, quantity)
    d_direct = np.zeros((output_shapes.shape[0], d))
    if quantity not in (RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY):
        d_output[:, :m] -= output_shapes @ d_spring / scale
        d_output[:, m:] -= output_shapes @ d_damping / step
        d_direct -= d_output_shapes @ system.participation + output_shapes @ d_participation

    transition, now, after, output, direct = state_matrices(a, system)
    both = StateMatrices(
        np.block([[transition, np.zeros_like(transition)], [d_transition, transition]]),
        np.vstack([now, d_now]),
        np.vstack([after, d_after]),
        np.block([[output, np.zeros_like(output)], [d_output, output]]),
        np.vstack([direct, d_direct]),
    )
    sums = np.zeros(a.shape[0])
    march_state_change(both, a.inputs, observed, history, sums)
    return sums
