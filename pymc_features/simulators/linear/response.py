"""Response and misfits of linear structures: any M, C and K, several supports or forces.

All functions take a `LinearParameters`, an `Excitation` and the `Outputs` wanted, see `arguments`. Where the
parameters describe no structure the result is NaN: M(theta) is not positive definite, K(theta) has a negative
eigenvalue, or the damping is negative.
"""

import numpy as np

from pymc_features.simulators.linear.arguments import Arguments
from pymc_features.simulators.linear.dense_population import dense_tables
from pymc_features.simulators.linear.state_space import march_state, state_matrices
from pymc_features.simulators.linear.system import ModalTables, is_coupled, modal_tables, solve_system
from pymc_features.simulators.oscillators.blocks import destination
from pymc_features.simulators.oscillators.march import march_modes


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
    """As `linear_response`, of an admissible structure whose modes are known: omega (m,), shapes (n, m)."""
    a = Arguments(parameters, excitation, wanted)
    a.check()
    return evaluate(a, solve_system(a, known=(omega, shapes)), None)


def linear_discrepancy(parameters, excitation, wanted, observed) -> np.ndarray:
    """e_j (s,) of Eq. (3), of the data `observed` (s, u)."""
    return linear_misfit(parameters, excitation, wanted, observed)[:, 0].copy()


def linear_misfit(parameters, excitation, wanted, observed) -> np.ndarray:
    """Statistics (s, 4) of the misfit with the data (s, u), in the order of `discrepancy.chain_misfit`.

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
        return evaluate(a, solve_system(a), observed)
    tables = dense_tables(a)
    return not_a_number(a, observed) if tables is None else march(a, tables, observed)


def evaluate(a, system, observed):
    """Response (s, u) of a system or, with data, its misfits (s, 4); NaN if there is no system."""
    if system is None:
        return not_a_number(a, observed)
    coupled = is_coupled(system.modal_damping)
    return march(a, state_matrices(a, system)[1] if coupled else modal_tables(a, system), observed)


def not_a_number(a, observed):
    """The result where the parameters describe no structure."""
    n_sensors, total = a.shape
    return np.full((n_sensors, total if observed is None else 4), np.nan)


def march(a, matrices, observed):
    """Response or misfits by `march_modes` (of `ModalTables`) or `march_state` (of `StateMatrices`)."""
    observed, history, sums = destination(a.shape, observed)
    if isinstance(matrices, ModalTables):
        acceleration, _, substeps, stride = a.inputs
        march_modes(*matrices, acceleration, substeps, stride, observed, history, sums)
    else:
        march_state(matrices, a.inputs, observed, history, sums)
    if history.size:
        return history
    sums[:2] /= a.shape[1]
    return np.ascontiguousarray(sums.T)
