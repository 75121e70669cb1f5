"""Exact response of coupled modes: first-order hold of the whole state.

With the state z = (s q, h q') of all modes, h the step, and inputs linear over it, the exact solution of
q" + D q' + Omega^2 q = -Gamma a(t) is

    z[k+1] = T z[k] + N a[k] + A a[k+1],   T = phi0(F),   N = (phi1(F) - phi2(F)) G,   A = phi2(F) G,
    F = [[0, S], [-(Omega h)^2 / S, -D h]],   G = (0, -h^2 Gamma),

phi0 = exp, phi1(z) = (e^z - 1)/z, phi2(z) = (e^z - 1 - z)/z^2, as in `recursion`. All of them are blocks
of one matrix exponential (Van Loan, IEEE Trans. Autom. Control 23, 395-404, 1978),

    exp [[F, G, 0], [0, 0, 1], [0, 0, 0]] = [[T, N + A, A], [0, 1, 1], [0, 0, 1]].

The scales S = max(Omega h, 1) make F small where a frequency is high: two to five times less rounding. The
outputs are y[k] = O z[k] + J a[k].
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.linear.system import observe
from pymc_features.simulators.oscillators.arguments import (
    RELATIVE_DISPLACEMENT,
    RELATIVE_VELOCITY,
    interpolate,
    n_outputs,
)
from pymc_features.simulators.oscillators.misfit import take_block
from pymc_features.simulators.oscillators.recursion import BLOCK


class StateMatrices(NamedTuple):
    """Recursion of the state and its outputs, or derivatives of a number by these matrices.

    Attributes
    ----------
    transition : array (2 m, 2 m)
        T.
    now, after : array (2 m, d)
        N and A, the weights of the inputs at both ends of the step.
    output : array (s, 2 m)
        O.
    direct : array (s, d)
        J, feed-through of the inputs.
    """

    transition: np.ndarray
    now: np.ndarray
    after: np.ndarray
    output: np.ndarray
    direct: np.ndarray


def generator(omega, modal_damping, participation, step):
    """The matrix whose exponential has all blocks, (2m + 2d, 2m + 2d), and the scales S (m,)."""
    m, d = participation.shape
    w = omega * step
    scale = np.maximum(w, 1.0)
    matrix = np.zeros((2 * m + 2 * d, 2 * m + 2 * d))
    matrix[:m, m : 2 * m] = np.diag(scale)
    matrix[m : 2 * m, :m] = np.diag(-w * w / scale)
    matrix[m : 2 * m, m : 2 * m] = -step * modal_damping
    matrix[m : 2 * m, 2 * m : 2 * m + d] = -step * step * participation
    matrix[2 * m : 2 * m + d, 2 * m + d :] = np.eye(d)
    return matrix, scale


def step_matrices(omega, modal_damping, participation, step):
    """T (2m, 2m), N and A (2m, d) of a step h [s].

    Parameters
    ----------
    omega : array (m,)
        [rad/s], not negative.
    modal_damping : array (m, m)
        D [1/s].
    participation : array (m, d)
        Gamma.
    """
    m, d = participation.shape
    whole = expm(generator(omega, modal_damping, participation, step)[0])
    both, after = whole[: 2 * m, 2 * m : 2 * m + d], whole[: 2 * m, 2 * m + d :]
    return tuple(np.ascontiguousarray(x) for x in (whole[: 2 * m, : 2 * m], both - after, after))


def output_matrix(omega, modal_damping, output_shapes, step, quantity):
    """O (s, 2m) of a quantity; accelerations are -S Phi (Omega^2 q + D q') and the feed-through.

    `output_shapes` (s, m) are S Phi, `quantity` is a position in `QUANTITIES`.
    """
    m, scale = omega.size, np.maximum(omega * step, 1.0)
    output = np.zeros((output_shapes.shape[0], 2 * m))
    if quantity == RELATIVE_DISPLACEMENT:
        output[:, :m] = output_shapes / scale
    elif quantity == RELATIVE_VELOCITY:
        output[:, m:] = output_shapes / step
    else:
        output[:, :m] = -output_shapes * (omega**2 / scale)
        output[:, m:] = -output_shapes @ modal_damping / step
    return output


def state_matrices(a, system) -> StateMatrices:
    """Matrices of a system."""
    omega, modal_damping, step = system.omega, system.modal_damping, a.step
    modes, direct = observe(a, system)
    steps = step_matrices(omega, modal_damping, system.participation, step)
    output = output_matrix(omega, modal_damping, modes.shapes, step, a.wanted.quantity)
    return StateMatrices(*steps, output, direct)


@jit
def block_samples(stride):
    """Output samples in a block of at most 128 steps; one, where it takes more steps."""
    return max(BLOCK // stride, 1)


@jit
def advance_state(matrices, excitation, first, count, states, ground):
    """Write the states after the first one, `count` steps of the recursion from step `first` on.

    Parameters
    ----------
    matrices : StateMatrices
    excitation : Excitation
        With inputs (d, t).
    states, ground : array (> count, 2m), (d, > count)
        States and inputs at the steps; all but `states[0]` are written.
    """
    now, after = matrices.now.T.copy(), matrices.after.T.copy()
    for i in range(ground.shape[0]):
        interpolate(excitation.acceleration[i], excitation.substeps, first, ground[i])
    for k in range(count):
        state = states[k + 1]
        np.dot(matrices.transition, states[k], state)
        for i in range(ground.shape[0]):
            for r in range(state.size):
                state[r] += now[i, r] * ground[i, k] + after[i, r] * ground[i, k + 1]


@jit
def march_state(matrices, excitation, observed, history, sums):
    """Carry coupled modes through the record; see `take_block` for what becomes of the response.

    Parameters as in `advance_state`, and `observed`, `history` and `sums` as in `take_block`.
    """
    (size, n_inputs), stride = matrices.now.shape, excitation.stride
    total = n_outputs(excitation.acceleration.shape[1], excitation.substeps, stride)
    samples = block_samples(stride)
    states, ground = np.zeros((samples * stride + 1, size)), np.zeros((n_inputs, samples * stride + 1))
    for first in range(0, total, samples):
        count = min(samples, total - first)
        steps = count * stride if first + count < total else (count - 1) * stride
        advance_state(matrices, excitation, first * stride, steps, states, ground)
        block = outputs_of(matrices, states, ground, count, stride)
        take_block(block, first, count, observed, history, sums)
        states[0] = states[steps]


@jit
def outputs_of(matrices, states, ground, count, stride):
    """Outputs (s, count) at every `stride`-th of some steps."""
    at_samples = np.ascontiguousarray(states[: count * stride : stride].T)
    inputs = np.ascontiguousarray(ground[:, : count * stride : stride])
    return np.dot(matrices.output, at_samples) + np.dot(matrices.direct, inputs)
