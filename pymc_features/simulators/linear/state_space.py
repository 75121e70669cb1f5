"""Exact response of coupled modes: first-order hold of the whole state.

The modes obey q" = -R (q, q', a), R = [Omega^2, D, Gamma]. With the state z = (S q, h q') of all modes, h the
step, and inputs a linear over it, the exact solution is

    z[k+1] = T z[k] + N a[k] + A a[k+1],   T = phi0(F),   N = (phi1(F) - phi2(F)) G,   A = phi2(F) G,
    F = [[0, S], [-(Omega h)^2 / S, -D h]],   G = (0, -h^2 Gamma),

phi0 = exp, phi1(z) = (e^z - 1)/z, phi2(z) = (e^z - 1 - z)/z^2, as in `recursion`. All of them are blocks
of one matrix exponential (Van Loan, IEEE Trans. Autom. Control 23, 395-404, 1978),

    exp [[F, G, 0], [0, 0, 1], [0, 0, 0]] = [[T, N + A, A], [0, 1, 1], [0, 0, 1]].

The scales S = max(Omega h, 1) make F small where a frequency is high: two to five times less rounding. The
outputs are y[k] = O z[k] + J a[k], and in exact arithmetic O z + J a = S Phi W (q, q', a), where W takes
q, q' or the accelerations -R from its argument.

Gradients of coupled modes: the adjoint of the recursion of `state_space`.

With z[k+1] = T z[k] + N a[k] + A a[k+1] and y[k] = O z[k] + J a[k], the derivatives of L by the states are

    mu[k] = T' mu[k+1] + O' w[k],   w = dL/dy,

and those by T, N, A, O and J are sums of products of mu, w, z and a. The states are computed again from
checkpoints, 128 steps at a time. The derivatives of the matrix exponential follow from its Frechet
derivative (Al-Mohy & Higham, SIAM J. Matrix Anal. Appl. 30, 1639-1657, 2009).

The modes are a basis Phi that is held fixed: the response does not depend on it, so that repeated frequencies
need no care. In this basis R = X^-1 [Phi' K Phi, Phi' C Phi, Phi' L], where X = Phi' M Phi is the identity
before any change, so that a change is dR = [..] - dX R.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm, expm_frechet

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.linear.projection import Cotangent
from pymc_features.simulators.linear.system import observe
from pymc_features.simulators.oscillators.arguments import (
    RELATIVE_DISPLACEMENT,
    RELATIVE_VELOCITY,
    interpolate,
    n_outputs,
    write_own,
)
from pymc_features.simulators.oscillators.misfit import weigh_history
from pymc_features.simulators.oscillators.modal_system import BLOCK, take_block

BY_LOOPS = 40  # states up to which the loops of a product take less time than a call of BLAS


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


class ModalEquations(NamedTuple):
    """Modal equations q" = -R (q, q', a) under steps of the recursion.

    Attributes
    ----------
    rows : array (m, 2m + d)
        R = [Omega^2, D, Gamma].
    scales : array (2m + d,)
        What (z, a) is of (q, q', a): S, h and 1.
    step : float
        h [s].
    """

    rows: np.ndarray
    scales: np.ndarray
    step: float

    def generator(self):
        """The matrix (2m + 2d, 2m + 2d) whose exponential has T, N + A and A in its first rows."""
        m, width = self.rows.shape
        matrix = np.zeros((2 * width - 2 * m, 2 * width - 2 * m))
        matrix[m : 2 * m, :width] = -(self.step**2) * self.rows / self.scales
        matrix[:m, m : 2 * m] = np.diag(self.scales[:m])
        matrix[2 * m : width, width:] = np.eye(width - 2 * m)
        return matrix

    def step_matrices(self):
        """T (2m, 2m), N and A (2m, d)."""
        n_states, width = 2 * len(self.rows), self.rows.shape[1]
        whole = expm(self.generator())[:n_states]
        transition, both, after = np.split(whole, [n_states, width], axis=1)
        return tuple(np.ascontiguousarray(x) for x in (transition, both - after, after))

    def selection(self, quantity):
        """W (m, 2m + d) of a quantity, a position in `QUANTITIES`."""
        m = len(self.rows)
        if quantity == RELATIVE_DISPLACEMENT:
            return np.eye(m, self.scales.size)
        return np.eye(m, self.scales.size, m) if quantity == RELATIVE_VELOCITY else -self.rows

    def output_matrix(self, output_shapes, quantity):
        """O (s, 2m) of mode shapes at the outputs S Phi (s, m)."""
        n_states = 2 * len(self.rows)
        return output_shapes @ self.selection(quantity)[:, :n_states] / self.scales[:n_states]


def modal_equations(omega, modal_damping, participation, step) -> ModalEquations:
    """Modal equations of omega (m,), D (m, m) and Gamma (m, d)."""
    rows = np.hstack([np.diag(omega**2), modal_damping, participation])
    h, one = np.full(omega.size, step), np.ones(participation.shape[1])
    return ModalEquations(rows, np.concatenate([np.maximum(omega * step, 1.0), h, one]), step)


def state_matrices(a, system):
    """Modal equations and `StateMatrices` of a system."""
    equations = modal_equations(system.omega, system.modal_damping, system.participation, a.step)
    modes, direct = observe(a, system)
    output = equations.output_matrix(modes.shapes, a.wanted.quantity)
    return equations, StateMatrices(*equations.step_matrices(), output, direct)


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
    now, after, size = matrices.now.T.copy(), matrices.after.T.copy(), matrices.now.shape[0]
    columns = matrices.transition.T.copy()
    for i in range(ground.shape[0]):
        interpolate(excitation.acceleration[i], excitation.substeps, first, ground[i])
    for k in range(count):
        state, before = states[k + 1], states[k]
        if size > BY_LOOPS:
            np.dot(matrices.transition, before, state)
        else:
            for r in range(size):
                state[r] = 0.0
            for c in range(size):
                for r in range(size):
                    state[r] += columns[c, r] * before[c]
        for i in range(ground.shape[0]):
            for r in range(size):
                state[r] += now[i, r] * ground[i, k] + after[i, r] * ground[i, k + 1]


@jit
def march_state(matrices, excitation, observed, history, sums):
    """Carry coupled modes through the record; see `take_block` for what becomes of the response.

    Parameters as in `advance_state` and `take_block`. Returns the states (blocks, 2m) at the first sample of
    each block.
    """
    (size, n_inputs), stride = matrices.now.shape, excitation.stride
    total = n_outputs(excitation.acceleration.shape[1], excitation.substeps, stride)
    samples = block_samples(stride)
    states, ground = np.zeros((samples * stride + 1, size)), np.zeros((n_inputs, samples * stride + 1))
    starts, own = np.zeros(((total + samples - 1) // samples, size)), np.empty((n_inputs, samples))
    for block in range(starts.shape[0]):
        first = block * samples
        count = min(samples, total - first)
        steps = count * stride if first + count < total else (count - 1) * stride
        advance_state(matrices, excitation, first * stride, steps, states, ground)
        starts[block] = states[0]
        at_samples = np.ascontiguousarray(states[: count * stride : stride].T)
        write_own(excitation, ground, first, count, own)
        inputs = np.ascontiguousarray(own[:, :count])
        outputs = np.dot(matrices.output, at_samples) + np.dot(matrices.direct, inputs)
        take_block(outputs, first, count, observed, history, sums)
        states[0] = states[steps]
    return starts


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
