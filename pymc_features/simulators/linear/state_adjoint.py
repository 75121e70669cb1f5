"""Gradients of coupled modes: the adjoint of the recursion of `state_space`.

With z[k+1] = T z[k] + N a[k] + A a[k+1] and y[k] = O z[k] + J a[k], the derivatives of L by the states are

    mu[k] = T' mu[k+1] + O' w[k],   w = dL/dy,

and those by T, N, A, O and J are sums of products of mu, w, z and a. The states are computed again from
checkpoints, 128 steps at a time. The derivatives of the matrix exponential follow from its Frechet
derivative (Al-Mohy & Higham, SIAM J. Matrix Anal. Appl. 30, 1639-1657, 2009).

The modes are a basis Phi that is held fixed: the response does not depend on it, so that repeated frequencies
need no care. In this basis R = X^-1 [Phi' K Phi, Phi' C Phi, Phi' L], where X = Phi' M Phi is the identity
before any change, so that a change is dR = [..] - dX R.
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
    march_state,
    state_matrices,
)
from pymc_features.simulators.oscillators.arguments import (
    RELATIVE_DISPLACEMENT,
    RELATIVE_VELOCITY,
    write_own,
)
from pymc_features.simulators.oscillators.misfit import weigh_history

NO_SUMS = np.empty((1, 0))  # of a comparison with data, where there is none


@jit
def matrix_gradients(matrices, excitation, starts, weighted):
    """Derivatives of L by all of `StateMatrices`.

    Parameters
    ----------
    matrices : StateMatrices
    excitation : Excitation
    starts : array (blocks, 2 m)
        States at the first sample of each block, from `march_state`.
    weighted : array (s, u)
        w = dL/dy.
    """
    (size, n_inputs), stride, total = matrices.now.shape, excitation.stride, weighted.shape[1]
    samples = block_samples(stride)
    states, ground = np.zeros((samples * stride + 1, size)), np.zeros((n_inputs, samples * stride + 1))
    adjoints, backward = np.zeros((samples * stride + 1, size)), np.ascontiguousarray(matrices.transition.T)
    grad_transition, grad_output = np.zeros((size, size)), np.zeros(matrices.output.shape)
    grad_now, grad_after = np.zeros((size, n_inputs)), np.zeros((size, n_inputs))
    grad_direct, at_samples = np.zeros(matrices.direct.shape), np.empty((n_inputs, samples))
    for block in range(starts.shape[0] - 1, -1, -1):
        first = block * samples
        count = min(samples, total - first)
        is_last = block + 1 == starts.shape[0]
        steps = (count - 1) * stride if is_last else count * stride
        states[0] = starts[block]
        advance_state(matrices, excitation, first * stride, steps, states, ground)
        own = np.ascontiguousarray(weighted[:, first : first + count])
        grad_output += np.dot(own, np.ascontiguousarray(states[: count * stride : stride]))
        write_own(excitation, ground, first, count, at_samples)
        grad_direct += np.dot(own, np.ascontiguousarray(at_samples[:, :count].T))
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
    m, quantity = system.omega.size, a.wanted.quantity
    equations, matrices = state_matrices(a, system)
    weighted = np.empty(a.shape)
    starts = march_state(matrices, a.inputs, weighted, weighted, NO_SUMS)
    if weights is None:
        weighted = writable(history)
    else:
        weigh_history(weighted, writable(history), writable(weights))
    grad = matrix_gradients(matrices, a.inputs, starts, weighted)

    # by R: the exponential of the generator has [T, N + A, A] in its rows
    generator, width = equations.generator(), equations.scales.size
    grad_exponential = np.zeros_like(generator)
    grad_exponential[: 2 * m] = np.hstack([grad.transition, grad.now, grad.after - grad.now])
    grad_generator = expm_frechet(generator.T, grad_exponential, compute_expm=False)
    grad_rows = -(a.step**2) * grad_generator[m : 2 * m, :width] / equations.scales
    # by S Phi and once more by R: [O, J] (z, a) = S Phi W (q, q', a)
    grad_outputs = np.hstack([grad.output, grad.direct]) / equations.scales
    grad_output_shapes = grad_outputs @ equations.selection(quantity).T
    if quantity not in (RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY):  # W = -R
        grad_rows -= (a.wanted.sensors @ system.shapes).T @ grad_outputs
    # by Phi outside its span, through Phi' C Phi, Phi' L and S Phi
    grad_stiffness, grad_damping, grad_load = np.split(grad_rows, [m, 2 * m], axis=1)
    shapes, damping = system.shapes, system.damping
    grad_shapes = a.wanted.sensors.T @ grad_output_shapes + system.load @ grad_load.T
    grad_shapes += (damping @ shapes) @ grad_damping.T + damping.T @ (shapes @ grad_damping)
    return Cotangent(
        stiffness=grad_stiffness,
        mass=-grad_rows @ equations.rows.T,
        damping=grad_damping,
        load=grad_load,
        shapes=grad_shapes,
        rayleigh=np.zeros(2),
        ratios=np.zeros(a.parameters.ratios.size),
    )
