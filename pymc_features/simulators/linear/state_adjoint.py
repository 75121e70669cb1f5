"""Gradients and tangents of coupled modes: the adjoint of the recursion of `state_space`.

With z[k+1] = T z[k] + N a[k] + A a[k+1] and y[k] = O z[k] + J a[k], the derivatives of L by the states are

    mu[k] = T' mu[k+1] + O' w[k],   w = dL/dy,

and those by T, N, A, O and J are sums of products of mu, w, z and a. The states are computed again from
checkpoints, 128 steps at a time. The derivatives of the matrix exponential follow from its Frechet
derivative (Al-Mohy & Higham, SIAM J. Matrix Anal. Appl. 30, 1639-1657, 2009). The modes are a basis that is
held fixed: the response does not depend on it, so that repeated frequencies need no care.
"""

import numpy as np
from scipy.linalg import expm_frechet

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.linear.arguments import writable
from pymc_features.simulators.linear.projection import Cotangent
from pymc_features.simulators.linear.state_space import advance_state, interpolate, step_matrices, step_system
from pymc_features.simulators.linear.system import observe
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY
from pymc_features.simulators.oscillators.blocks import take_change
from pymc_features.simulators.oscillators.recursion import BLOCK


@jit
def weigh_states(states, ground, first, stride, output, direct, history, weights, weighted):
    """Write the derivatives of L by the outputs at some steps, (steps, s), zero where there is no output.

    Parameters
    ----------
    states, ground : array (steps, 2 m), (steps, d)
        From step `first` on.
    history, weights
        As in `oscillator_sums.sum_histories`.
    """
    total = history.shape[1]
    response = np.dot(states, output.T) + np.dot(ground, direct.T)
    for b in range(states.shape[0]):
        sample = (first + b) // stride
        for j in range(history.shape[0]):
            if (first + b) % stride:
                weighted[b, j] = 0.0
            elif weights.size:
                weighted[b, j] = 2.0 * weights[j] / total * (response[b, j] - history[j, sample])
            else:
                weighted[b, j] = history[j, sample]


@jit
def state_sums(transition, now, after, output, direct, inputs, substeps, stride, history, weights):
    """Derivatives of L by the transition, the weights of both ends of the step, output and feed-through.

    Parameters
    ----------
    transition, now, after, output : arrays
        From `step_matrices`.
    direct : array (s, d)
    history, weights
        As in `oscillator_sums.sum_histories`.
    """
    size, n_inputs = now.shape
    steps = (history.shape[1] - 1) * stride
    segments = max((steps + BLOCK - 1) // BLOCK, 1)
    states, ground = np.zeros((BLOCK + 1, size)), np.zeros((BLOCK + 1, n_inputs))
    checkpoints = np.zeros((segments, size))
    for segment in range(segments - 1):
        states[0] = checkpoints[segment]
        advance_state(transition, now, after, inputs, substeps, segment * BLOCK, BLOCK, states, ground)
        checkpoints[segment + 1] = states[BLOCK]
    by_transition, by_now, by_after = np.zeros((size, size)), np.zeros(now.shape), np.zeros(now.shape)
    by_output, by_direct = np.zeros(output.shape), np.zeros(direct.shape)
    weighted, adjoints = np.zeros((BLOCK + 1, direct.shape[0])), np.zeros((BLOCK, size))
    backward, adjoint = np.ascontiguousarray(transition.T), np.zeros(size)
    for segment in range(segments - 1, -1, -1):
        first = segment * BLOCK
        count = min(BLOCK, steps - first)
        states[0] = checkpoints[segment]
        advance_state(transition, now, after, inputs, substeps, first, count, states, ground)
        weigh_states(
            *(states[: count + 1], ground[: count + 1], first, stride),
            *(output, direct, history, weights, weighted),
        )
        start = 0 if segment == 0 else 1  # the last state of a segment is the first of the next
        own = weighted[start : count + 1]
        by_output += np.dot(own.T, states[start : count + 1])
        by_direct += np.dot(own.T, ground[start : count + 1])
        loads = np.dot(weighted[: count + 1], output)
        for b in range(count - 1, -1, -1):
            adjoint = adjoint + loads[b + 1]
            adjoints[b] = adjoint
            adjoint = np.dot(backward, adjoint)
        own_adjoints = adjoints[:count].T
        by_transition += np.dot(own_adjoints, states[:count])
        by_now += np.dot(own_adjoints, ground[:count])
        by_after += np.dot(own_adjoints, ground[1 : count + 1])
    return by_transition, by_now, by_after, by_output, by_direct


@jit
def march_state_change(
    transition, now, after, output, direct, inputs, substeps, stride, observed, history, sums
):
    """Carry the response and its change through the record; see `take_change` for what becomes of them.

    The matrices are those of states beside their changes; the outputs likewise, the response first.
    """
    size, n_inputs = now.shape
    n_sensors = direct.shape[0] // 2
    total = max(history.shape[1], observed.shape[1])
    states, ground = np.zeros((stride + 1, size)), np.zeros((stride + 1, n_inputs))
    both = np.empty((BLOCK, 2 * n_sensors))
    for first in range(0, total, BLOCK):
        count = min(BLOCK, total - first)
        for b in range(count):
            if first + b == 0:
                interpolate(inputs, 0, substeps, ground[stride])
            else:
                states[0] = states[stride]
                begin = (first + b - 1) * stride
                advance_state(transition, now, after, inputs, substeps, begin, stride, states, ground)
            both[b] = np.dot(output, states[stride]) + np.dot(direct, ground[stride])
        take_change(
            *(both[:, :n_sensors], both[:, n_sensors:], first, count, observed, history, sums),
        )


def pull_back(a, system, history, weights):
    """Derivatives of L = sum w y, or of sum_j c_j e_j with `weights` c, see `Cotangent`."""
    m, d = system.participation.shape
    seen, direct = observe(a, system)
    matrices = step_matrices(system.omega, system.drag, system.participation, seen, a.step, a.quantity)
    by_transition, by_now, by_after, by_output, by_direct = state_sums(
        *(*matrices, direct, a.inputs, *a.grid),
        *(writable(history), writable(weights)),
    )
    system_matrix, scale = step_system(system.omega, system.drag, system.participation, a.step)
    by_whole = np.zeros_like(system_matrix)
    by_whole[: 2 * m, : 2 * m] = by_transition
    by_whole[: 2 * m, 2 * m : 2 * m + d] = by_now
    by_whole[: 2 * m, 2 * m + d :] = by_after - by_now
    by_system = expm_frechet(system_matrix.T, by_whole, compute_expm=False)[m : 2 * m]
    by_spring = -(a.step**2) * by_system[:, :m] / scale
    by_drag = -a.step * by_system[:, m : 2 * m]
    by_load = -(a.step**2) * by_system[:, 2 * m : 2 * m + d]
    of_q, of_p = by_output[:, :m] / scale, by_output[:, m:] / a.step
    if a.quantity == RELATIVE_DISPLACEMENT:
        by_seen = of_q
    elif a.quantity == RELATIVE_VELOCITY:
        by_seen = of_p
    else:
        by_seen = -of_q * system.omega**2 - of_p @ system.drag.T - by_direct @ system.participation.T
        by_spring -= seen.T @ of_q
        by_drag -= seen.T @ of_p
        by_load -= seen.T @ by_direct
    shapes = system.shapes
    outside = a.sensors.T @ by_seen + system.load @ by_load.T
    outside += (system.damping @ shapes) @ by_drag.T + system.damping.T @ (shapes @ by_drag)
    by_mass = by_drag @ system.drag.T + by_spring * system.omega**2 + by_load @ system.participation.T
    return Cotangent(
        *(by_spring, -by_mass, by_drag, by_load, outside),
        *(np.zeros(2), np.zeros(a.ratios.size)),
    )


def push_forward(a, system, motion, d_rayleigh, d_ratios, observed, history, sums):
    """Write the change of the response, or of its comparison with data, see `take_change`.

    With a matrix for damping nothing depends on `d_rayleigh` and `d_ratios`.
    """
    m, d = system.participation.shape
    shapes, step, square = system.shapes, a.step, system.omega**2
    mixed = motion.shapes.T @ (system.damping @ shapes) + (shapes.T @ system.damping) @ motion.shapes
    drag = motion.damping + mixed - motion.mass @ system.drag
    spring = motion.stiffness - motion.mass * square
    load = motion.load + motion.shapes.T @ system.load - motion.mass @ system.participation
    seen, direct = observe(a, system)
    moved = a.sensors @ motion.shapes
    matrices = step_matrices(system.omega, system.drag, system.participation, seen, step, a.quantity)
    system_matrix, scale = step_system(system.omega, system.drag, system.participation, step)
    change = np.zeros_like(system_matrix)
    change[m : 2 * m, :m] = -step * step * spring / scale
    change[m : 2 * m, m : 2 * m] = -step * drag
    change[m : 2 * m, 2 * m : 2 * m + d] = -step * step * load
    whole = expm_frechet(system_matrix, change, compute_expm=False)[: 2 * m]
    second = whole[:, 2 * m + d :]
    changes = whole[:, : 2 * m], whole[:, 2 * m : 2 * m + d] - second, second
    output, d_direct = np.zeros((seen.shape[0], 2 * m)), np.zeros(direct.shape)
    if a.quantity == RELATIVE_DISPLACEMENT:
        output[:, :m] = moved / scale
    elif a.quantity == RELATIVE_VELOCITY:
        output[:, m:] = moved / step
    else:
        output[:, :m] = -(moved * square + seen @ spring) / scale
        output[:, m:] = -(moved @ system.drag + seen @ drag) / step
        d_direct = -(moved @ system.participation + seen @ load)
    transition, now, after, own_output = matrices
    none = np.zeros_like
    march_state_change(
        np.block([[transition, none(transition)], [changes[0], transition]]),
        *(np.vstack([now, changes[1]]), np.vstack([after, changes[2]])),
        np.block([[own_output, none(own_output)], [output, own_output]]),
        *(np.vstack([direct, d_direct]), a.inputs, *a.grid),
        *(observed, history, sums),
    )
