"""Misfits of populations of linear structures: modes one by one, the recursion for several at once.

Dense structures with classical damping under one input stay in compiled code, `dense_structures`.

theta, rayleigh and ratios have one more axis in front, a row for each particle or one for all.
"""

import numpy as np

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.eigen.coupled import march_coupled
from pymc_features.simulators.linear.arguments import Arguments, is_symmetric, n_particles
from pymc_features.simulators.linear.dense_structures import dense_statistics, dense_systems
from pymc_features.simulators.linear.response import evaluate
from pymc_features.simulators.linear.system import observe, solved
from pymc_features.simulators.long_records.systems import Systems, new_systems, put_modes
from pymc_features.simulators.oscillators.modal_system import has_fast, highest_step


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
    observed, given, one_input = (
        writable(observed),
        shared.parameters,
        a.excitation.acceleration.shape[0] == 1,
    )
    if given.is_dense and given.is_classical and one_input:
        return dense_statistics(a.parameters.for_kernel(), a.inputs, a.outputs, observed, n_statistics)
    result, is_written = np.full((count, a.shape[0], n_statistics), np.nan), np.zeros(count)
    if given.is_dense and one_input and is_symmetric(given.damping, given.n_dof):
        kernel = a.parameters.for_kernel()
        result, is_written = march_coupled(kernel, a.inputs, a.outputs, observed, n_statistics)
        result, is_written = np.resize(result, (count, *result.shape[1:])), np.resize(is_written, count)
    for p, own, system in solved(a, np.flatnonzero(~is_written.astype(bool))):
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
