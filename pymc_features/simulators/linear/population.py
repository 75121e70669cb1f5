"""Misfits of populations of linear structures: modes one by one, the recursion for several at once.

Dense structures with classical damping under one input stay in compiled code, `dense_population`.

theta, rayleigh and ratios have one more axis in front, a row for each particle or one for all.
"""

import numpy as np

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.linear.arguments import Arguments, n_particles
from pymc_features.simulators.linear.dense_population import march_dense
from pymc_features.simulators.linear.response import evaluate
from pymc_features.simulators.linear.system import is_coupled, modal_tables, solve_system
from pymc_features.simulators.oscillators.population_march import march_group


def linear_population_discrepancy(parameters, excitation, wanted, observed) -> np.ndarray:
    """e_j (p, s) of Eq. (3) of all particles, of the data `observed` (s, u); NaN in invalid rows.

    Memory: the result and a few blocks, whatever the length of the record and the number of particles.
    """
    return march_population(Arguments(parameters, excitation, wanted), observed, False)[:, :, 0].copy()


def linear_population_misfit(parameters, excitation, wanted, observed) -> np.ndarray:
    """What `linear_misfit` returns, for all particles: (p, s, 4)."""
    return march_population(Arguments(parameters, excitation, wanted), observed, True)


def march_population(a: Arguments, observed, with_increments):
    """Misfits (p, s, 1 or 4) of all particles."""
    count, shared = n_particles(a.parameters), a._replace(parameters=a.parameters.one_of(0))
    shared.check(observed)
    observed, increments = writable(observed), with_increments or None
    given, one_input = shared.parameters, a.excitation.acceleration.shape[0] == 1
    if given.is_dense and given.is_classical and one_input:
        return march_dense(a.parameters.for_kernel(), a.inputs, a.outputs, observed, increments)
    result = np.full((count, a.shape[0], 4 if with_increments else 1), np.nan)
    places, waiting = [], []
    for p in range(count):
        own = a._replace(parameters=a.parameters.one_of(p))
        system = solve_system(own)
        if system is None:
            continue
        if one_input and not is_coupled(system.modal_damping):
            places.append(p)
            waiting.append(modal_tables(own, system))
        else:
            result[p] = evaluate(own, system, observed)[:, : result.shape[2]]
        if len(waiting) == LANES:
            result[places] = march_together(waiting, a.inputs, observed, increments)
            places, waiting = [], []
    if waiting:
        result[places] = march_together(waiting, a.inputs, observed, increments)
    return result


def march_together(tables, excitation, observed, increments):
    """Misfits of up to `LANES` particles under one input, from their `ModalTables`."""
    table, shapes, direct = (np.stack(arrays) for arrays in zip(*tables, strict=True))
    acceleration, _, substeps, stride = excitation
    return march_group(
        table,
        np.ascontiguousarray(shapes[:, 0]),
        np.ascontiguousarray(direct[:, :, 0]),
        acceleration[0],
        substeps,
        stride,
        observed,
        increments,
    )
