"""Exact response of coupled modes: first-order hold of the whole state.

With the state z = (s q, h q') of all modes, h the step, and inputs linear over it, the exact solution of
q" + D q' + Omega^2 q = -Gamma a(t) is

    z[k+1] = phi0(F) z[k] + (phi1(F) - phi2(F)) G a[k] + phi2(F) G a[k+1],
    F = [[0, S], [-(Omega h)^2 / S, -D h]],   G = (0, -h^2 Gamma),

phi0 = exp, phi1(z) = (e^z - 1)/z, phi2(z) = (e^z - 1 - z)/z^2, as in `recursion`. All of them are blocks
of one matrix exponential (Van Loan, IEEE Trans. Autom. Control 23, 395-404, 1978). The scales
S = max(Omega h, 1) make F small where a frequency is high: two to five times less rounding.
"""

import numpy as np
from scipy.linalg import expm

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY, n_outputs
from pymc_features.simulators.oscillators.blocks import take_block
from pymc_features.simulators.oscillators.recursion import BLOCK


def step_system(omega, damping, participation, step):
    """The matrix whose exponential has all blocks, (2m + 2d, 2m + 2d), and the scales S (m,)."""
    m, d = participation.shape
    w = omega * step
    scale = np.maximum(w, 1.0)
    system = np.zeros((2 * m + 2 * d, 2 * m + 2 * d))
    system[:m, m : 2 * m] = np.diag(scale)
    system[m : 2 * m, :m] = np.diag(-w * w / scale)
    system[m : 2 * m, m : 2 * m] = -step * damping
    system[m : 2 * m, 2 * m : 2 * m + d] = -step * step * participation
    system[2 * m : 2 * m + d, 2 * m + d :] = np.eye(d)
    return system, scale


def step_matrices(omega, damping, participation, seen, step, quantity):
    """Transition (2m, 2m), weights (2m, d) of both ends of the step, and output matrix (s, 2m).

    Parameters
    ----------
    omega : array (m,)
        [rad/s], not negative.
    damping : array (m, m)
        D [1/s].
    participation : array (m, d)
        Gamma.
    seen : array (s, m)
        Mode shapes at the outputs.
    step : float
        h [s].
    quantity : int
        A position in `QUANTITIES`; feed-through is not included.
    """
    m, d = participation.shape
    system, scale = step_system(omega, damping, participation, step)
    whole = expm(system)
    first, second = whole[: 2 * m, 2 * m : 2 * m + d], whole[: 2 * m, 2 * m + d :]
    output = np.zeros((seen.shape[0], 2 * m))
    if quantity == RELATIVE_DISPLACEMENT:
        output[:, :m] = seen / scale
    elif quantity == RELATIVE_VELOCITY:
        output[:, m:] = seen / step
    else:
        output[:, :m] = -seen * (omega**2 / scale)
        output[:, m:] = -seen @ damping / step
    arrays = whole[: 2 * m, : 2 * m], first - second, second, output
    return tuple(np.ascontiguousarray(a) for a in arrays)


@jit
def advance_state(transition, now, after, inputs, substeps, first, count, states, ground):
    """Write the states after state 0, `count` steps of the recursion from step `first` on.

    Parameters
    ----------
    states, ground : array (> count, 2m), (> count, d)
        States and inputs at the steps; all but `states[0]` are written.
    """
    interpolate(inputs, first, substeps, ground[0])
    for k in range(count):
        interpolate(inputs, first + k + 1, substeps, ground[k + 1])
        states[k + 1] = np.dot(transition, states[k]) + np.dot(now, ground[k]) + np.dot(after, ground[k + 1])


@jit
def march_state(transition, now, after, output, direct, inputs, substeps, stride, observed, history, sums):
    """Carry coupled modes through the record; see `take_block` for what becomes of the response.

    Parameters
    ----------
    transition, now, after, output : arrays
        From `step_matrices`.
    direct : array (s, d)
        Feed-through of the inputs.
    inputs : array (d, t)
    substeps, stride : int
        As in `recursion.advance`.
    """
    size, n_inputs = now.shape
    total = n_outputs(inputs.shape[1], substeps, stride)
    own_states, own_ground = np.zeros((stride + 1, size)), np.zeros((stride + 1, n_inputs))
    states, ground = np.zeros((BLOCK, size)), np.zeros((BLOCK, n_inputs))
    for first in range(0, total, BLOCK):
        count = min(BLOCK, total - first)
        for b in range(count):
            if first + b > 0:
                own_states[0] = own_states[stride]
                begin = (first + b - 1) * stride
                advance_state(
                    *(transition, now, after, inputs, substeps, begin, stride, own_states, own_ground)
                )
            states[b] = own_states[stride]
            interpolate(inputs, (first + b) * stride, substeps, ground[b])
        block = np.dot(output, states.T) + np.dot(direct, ground.T)
        take_block(block, first, count, observed, history, sums)


@jit
def interpolate(inputs, fine, substeps, values):
    """Write the inputs at a step of the recursion, linear between their samples."""
    i = fine // substeps
    weight = (fine - i * substeps) / substeps
    for j in range(inputs.shape[0]):
        values[j] = inputs[j, i]
        if weight > 0.0:
            values[j] += weight * (inputs[j, i + 1] - inputs[j, i])
