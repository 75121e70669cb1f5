"""Response and misfits of linear structures: any M, C and K, several supports or forces.

All functions take a `LinearParameters`, an `Excitation` and the `Outputs` wanted, see `arguments`. Where the
parameters describe no structure the result is NaN: M(theta) or K(theta) has a negative eigenvalue, they are
singular on the same motion, M(theta) has fewer modes than are kept, or the damping is negative.
"""

import numpy as np

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.linear.arguments import Arguments, n_particles
from pymc_features.simulators.linear.coupled import march_coupled
from pymc_features.simulators.linear.dense_structures import (
    dense_statistics,
    dense_systems,
    evaluate_structure,
)
from pymc_features.simulators.linear.oscillators import march_modes
from pymc_features.simulators.linear.state_space import response_of
from pymc_features.simulators.linear.system import is_coupled, observe, solve_system, solved, solved_alone
from pymc_features.simulators.oscillators.misfit import statistics
from pymc_features.simulators.oscillators.modal_system import has_fast, highest_step
from pymc_features.simulators.oscillators.systems import Systems, new_systems, put_modes


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

    Memory: a few blocks of samples; of modes that the damping couples their states at all steps as well.
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
    kernel = a.parameters.as_population().for_kernel()
    sums = evaluate_structure(kernel, a.inputs, a.outputs, observed, history)
    return history if history.size else sums


def evaluate(a, system, observed):
    """Response (s, u) of a system or, with data, its misfits (s, 4); NaN if there is no system."""
    if system is None:
        return np.full(a.shape if observed is None else (a.shape[0], 4), np.nan)
    if is_coupled(system.modal_damping):
        response = response_of(a, system)
        return response if observed is None else statistics(response, observed)
    observed, history = data_or_history(a, observed)
    found = march_modes(a, system, observed, history)
    return history if history.size else found


def data_or_history(a, observed):
    """Data (s, u) and no room for a history, or, without data, a history (s, u) twice."""
    if observed is not None:
        return writable(observed), np.empty((0, 0))
    history = np.empty(a.shape)
    return history, history


# --- populations: modes one by one, the recursion for several at once ---------------------------------------


def linear_population_discrepancy(parameters, excitation, wanted, observed) -> np.ndarray:
    """e_j (p, s) of Eq. (3) of all particles, of the data `observed` (s, u); NaN in invalid rows.

    Memory: the result and a few blocks, whatever the length of the record and the number of particles.
    """
    return march_population(Arguments(parameters, excitation, wanted), observed, 1)[:, :, 0].copy()


def linear_population_misfit(parameters, excitation, wanted, observed) -> np.ndarray:
    """What `linear_misfit` returns, for all particles: (p, s, 4)."""
    return march_population(Arguments(parameters, excitation, wanted), observed, 4)


def march_population(a: Arguments, observed, n_statistics):
    """Misfits (p, s, 1 or 4) of all particles."""
    count, shared = n_particles(a.parameters), a._replace(parameters=a.parameters.one_of(0))
    shared.check(observed)
    observed, given = writable(observed), shared.parameters
    if given.is_dense and given.is_classical:
        return dense_statistics(a.parameters.for_kernel(), a.inputs, a.outputs, observed, n_statistics)
    result, is_written = np.full((count, a.shape[0], n_statistics), np.nan), np.zeros(count, dtype=bool)
    if shared.has_pairs:
        kernel = a.parameters.for_kernel()
        result, is_written = march_coupled(kernel, a.inputs, a.outputs, observed, n_statistics)
    for p, own, system in solved(a, np.flatnonzero(~is_written)):
        if system is not None:
            result[p] = evaluate(own, system, observed)[:, :n_statistics]
    return result


def linear_systems(parameters, excitation, wanted, observed) -> Systems | None:
    """`Systems` of all particles; None if a matrix couples their modes."""
    a = Arguments(parameters, excitation, wanted)
    count, shared = n_particles(parameters), a._replace(parameters=parameters.one_of(0))
    shared.check(observed)
    if not parameters.is_classical:
        return None
    if parameters.is_dense:
        return dense_systems(parameters.for_kernel(), a.inputs, a.outputs, count)
    systems = new_systems(count, a.shape[0], wanted.n_modes, excitation.acceleration.shape[0])
    for p, own, system in solved(a, np.arange(count)):
        modes = None if system is None else observe(own, system)
        if modes and not has_fast(modes[0], a.step, highest_step(a.inputs)):
            put_modes(systems, p, *modes)
    return systems


def linear_gradient_systems(parameters, excitation, wanted, observed) -> Systems | None:
    """Modes from which `linear_gradient_of_sums` goes on; None where it cannot."""
    one_input = excitation.acceleration.shape[0] == 1
    if not (parameters.is_dense and parameters.is_classical and one_input):
        return None
    return linear_systems(parameters, excitation, wanted, observed)
