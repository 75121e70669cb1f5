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

the same recursion from the end of the record to its beginning, and those by T, N, A, O and J are sums of
products of mu, w, z and a. The derivatives of the matrix exponential follow from its Frechet derivative
(Al-Mohy & Higham, SIAM J. Matrix Anal. Appl. 30, 1639-1657, 2009).

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
)
from pymc_features.simulators.oscillators.misfit import weigh_history

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
def carry_on(transition, states):
    """Add to each of the states (t, n) but the first what the transition makes of the one before it."""
    size, columns, moved = transition.shape[0], transition.T.copy(), np.empty(transition.shape[0])
    for k in range(1, states.shape[0]):
        before, state = states[k - 1], states[k]
        if size > BY_LOOPS:
            np.dot(transition, before, moved)
            for r in range(size):
                state[r] += moved[r]
        else:
            for c in range(0, size, 2):  # all states come in pairs
                for r in range(size):
                    state[r] += columns[c, r] * before[c] + columns[c + 1, r] * before[c + 1]


class Marched(NamedTuple):
    """States of a record at all steps, and its inputs.

    Attributes
    ----------
    states : array (t, 2 m)
        z at the steps up to the last output.
    ground : array (d, t)
        Inputs at these steps.
    own : array (d, u)
        The inputs' own values at the outputs.
    """

    states: np.ndarray
    ground: np.ndarray
    own: np.ndarray


def march_states(a, matrices) -> Marched:
    """Take the state through the record, from rest."""
    acceleration, _, substeps, stride, direct = a.excitation
    total = a.shape[1]
    ground = acceleration[:, : (total - 1) * stride + 1]
    if substeps > 1:
        sample, part = np.divmod(np.arange((total - 1) * stride + 1), substeps)
        following = np.minimum(sample + 1, acceleration.shape[1] - 1)
        before, after = acceleration[:, sample], acceleration[:, following]
        ground = before + part / substeps * (after - before)
    own = ground[:, ::stride] if direct.size == 0 else direct[0, :, :total]
    states = np.zeros((ground.shape[1], len(matrices.now)))
    ends = np.concatenate([ground[:, :-1], ground[:, 1:]])
    np.matmul(ends.T, np.hstack([matrices.now, matrices.after]).T, out=states[1:])
    carry_on(matrices.transition, states)
    return Marched(states, ground, own)


def outputs_of(a, matrices, marched):
    """Response (s, u)."""
    at_outputs = marched.states[:: a.excitation.stride]
    return matrices.output @ at_outputs.T + matrices.direct @ marched.own


def response_of(a, system):
    """Response (s, u) of a system. Memory: the states at all steps."""
    _, matrices = state_matrices(a, system)
    return outputs_of(a, matrices, march_states(a, matrices))


def matrix_gradients(a, matrices, marched, weighted):
    """Derivatives of L by all of `StateMatrices`; w = dL/dy (s, u)."""
    states, ground, own = marched
    backward = np.zeros(states.shape)
    backward[:: a.excitation.stride] = weighted.T @ matrices.output
    backward = np.ascontiguousarray(backward[::-1])
    carry_on(np.ascontiguousarray(matrices.transition.T), backward)
    following = backward[-2::-1].T
    return StateMatrices(
        following @ states[:-1],
        following @ ground[:, :-1].T,
        following @ ground[:, 1:].T,
        weighted @ states[:: a.excitation.stride],
        weighted @ own.T,
    )


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
    Memory: the response of this one structure, and its states at all steps.
    """
    m, quantity = system.omega.size, a.wanted.quantity
    equations, matrices = state_matrices(a, system)
    marched = march_states(a, matrices)
    if weights is not None:
        response = outputs_of(a, matrices, marched)
        weigh_history(response, writable(history), writable(weights))
        history = response
    grad = matrix_gradients(a, matrices, marched, history)

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
