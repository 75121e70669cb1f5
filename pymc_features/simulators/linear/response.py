"""Response and misfits of linear structures: any M, C and K, several supports or forces.

All functions take a `LinearParameters`, an `Excitation` and the `Outputs` wanted, see `arguments`. Where the
parameters describe no structure the result is NaN: M(theta) or K(theta) has a negative eigenvalue, they are
singular on the same motion, M(theta) has fewer modes than are kept, or the damping is negative.
"""

import numpy as np

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.linear.arguments import Arguments
from pymc_features.simulators.linear.dense_structures import evaluate_structure
from pymc_features.simulators.linear.oscillators import march_modes
from pymc_features.simulators.linear.state_space import march_state, state_matrices
from pymc_features.simulators.linear.system import is_coupled, solve_system, solved_alone
from pymc_features.simulators.oscillators.modal_system import statistics


def linear_response(parameters, excitation, wanted) -> np.ndarray:
    """Response history (s, u), exact for inputs that are linear between their samples.

    Notes
    -----
    Modes that the damping couples are integrated together by a matrix exponential, see `state_space`, all
    others singly.
    """
    a = Arguments(parameters, excitation, wanted)
    a.check()
    return solve(a, None)


def response_in_modes(omega, shapes, parameters, excitation, wanted) -> np.ndarray:
    """Response of an admissible structure whose modes are known: omega (m,), shapes (n, m)."""
    a = Arguments(parameters, excitation, wanted)
    a.check()
    return evaluate(a, solve_system(a, known=(omega, shapes)), None)


def linear_discrepancy(parameters, excitation, wanted, observed) -> np.ndarray:
    """e_j (s,) of Eq. (3), of the data `observed` (s, u)."""
    return linear_misfit(parameters, excitation, wanted, observed)[:, 0].copy()


def linear_misfit(parameters, excitation, wanted, observed) -> np.ndarray:
    """Statistics (s, 4) of the misfit with the data (s, u), in the order of `oscillators.misfit`.

    Memory: a few blocks of 128 samples; of modes that the damping couples their state at every 128th step as
    well.
    """
    a = Arguments(parameters, excitation, wanted)
    a.check(observed)
    return solve(a, observed)


def solve(a, observed):
    """Response (s, u) or, with data, misfits (s, 4); NaN if there is no structure.

    Dense structures with classical damping stay in compiled code.
    """
    if not (a.parameters.is_dense and a.parameters.is_classical):
        return evaluate(*solved_alone(a), observed)
    observed, history = data_or_history(a, observed)
    kernel = a.parameters.for_kernel()
    sums = evaluate_structure(kernel, kernel.random, a.inputs, a.outputs, observed, history)
    return history if history.size else sums


def evaluate(a, system, observed):
    """Response (s, u) of a system or, with data, its misfits (s, 4); NaN if there is no system."""
    observed, history = data_or_history(a, observed)
    sums = np.zeros((4, a.shape[0]))
    if system is None:
        history[:], sums[:] = np.nan, np.nan
    elif is_coupled(system.modal_damping):
        march_state(state_matrices(a, system)[1], a.inputs, observed, history, sums)
    else:
        found = march_modes(a, system, observed, history)
        return history if history.size else found
    return history if history.size else statistics(sums, a.shape[1])


def data_or_history(a, observed):
    """Data (s, u) and no room for a history, or, without data, a history (s, u) twice."""
    if observed is not None:
        return writable(observed), np.empty((0, 0))
    history = np.empty(a.shape)
    return history, history
