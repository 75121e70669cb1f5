"""Response and discrepancies of linear structures: any M, C and K, several supports or forces.

The parameters of all functions are those of `Arguments`, in their order, and what else is said. Where they
describe no structure the result is NaN: M(theta) is not positive definite, K(theta) has a negative
eigenvalue, or the damping is negative.
"""

import numpy as np

from pymc_features.simulators.linear.arguments import Arguments
from pymc_features.simulators.linear.dense_population import dense_tables
from pymc_features.simulators.linear.state_space import march_state, step_matrices
from pymc_features.simulators.linear.system import is_coupled, observe, solve_system
from pymc_features.simulators.oscillators.blocks import destination
from pymc_features.simulators.oscillators.march import classical_matrices, march_modes


def linear_response(parameters, excitation, wanted) -> np.ndarray:
    """Response history (s, u), exact for inputs that are linear between their samples.

    Notes
    -----
    Modes that the damping couples are carried together by a matrix exponential, see `state_space`, all
    others singly.
    """
    a = Arguments(*parameters, *excitation, *wanted)
    a.check()
    return solve(a, None)


def response_in_modes(omega, shapes, parameters, excitation, wanted) -> np.ndarray:
    """As `linear_response`, of an admissible structure whose modes are known: omega (m,), shapes (n, m)."""
    a = Arguments(*parameters, *excitation, *wanted)
    a.check()
    return evaluate(a, solve_system(a, known=(omega, shapes)), None)


def linear_discrepancy(parameters, excitation, wanted, observed) -> np.ndarray:
    """e_j (s,) of Eq. (3), of the data that follow the arguments, `observed` (s, u)."""
    return linear_misfit(parameters, excitation, wanted, observed)[:, 0].copy()


def linear_misfit(parameters, excitation, wanted, observed) -> np.ndarray:
    """What `discrepancy.chain_misfit` returns, (s, 4), of the data that follow the arguments.

    Memory: a few blocks of 128 samples, whatever the length of the record.
    """
    a = Arguments(*parameters, *excitation, *wanted)
    a.check(observed)
    return solve(a, observed)


def solve(a, observed):
    """Response (s, u) or, with data, misfits (s, 4); NaN if there is no structure.

    Dense structures with classical damping stay in compiled code.
    """
    if not (a.is_dense and a.is_classical):
        return evaluate(a, solve_system(a), observed)
    tables = dense_tables(a)
    return nothing(a, observed) if tables is None else march(a, march_modes, tables, observed)


def evaluate(a, system, observed):
    """Response (s, u) of a system or, with data, their misfits (s, 4); NaN if there is no system."""
    if system is None:
        return nothing(a, observed)
    seen, direct = observe(a, system)
    if is_coupled(system.drag):
        matrices = step_matrices(system.omega, system.drag, system.participation, seen, a.step, a.quantity)
        return march(a, march_state, (*matrices, direct), observed)
    return march(a, march_modes, (*classical_matrices(a, system, seen), direct), observed)


def nothing(a, observed):
    """What is returned where there is no structure."""
    n_sensors, total = a.shape
    return np.full((n_sensors, total if observed is None else 4), np.nan)


def march(a, kernel, matrices, observed):
    """Response or misfits by `march_modes` or `march_state`."""
    observed, history, sums = destination(a.shape, observed)
    kernel(*matrices, a.inputs, *a.grid, observed, history, sums)
    if history.size:
        return history
    sums[:2] /= a.shape[1]
    return np.ascontiguousarray(sums.T)
