"""Gradients of response and misfit of linear structures by theta, Rayleigh pair and damping ratios.

All functions take a `LinearParameters`, an `Excitation` and the `Outputs` wanted, and what else is said. The
cost does not grow with the number of parameters but for one product with the stacks of their entries.
"""

import numpy as np

from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.linear import oscillators, state_space
from pymc_features.simulators.linear.arguments import Arguments, n_particles
from pymc_features.simulators.linear.coupled import add_coupled_gradients
from pymc_features.simulators.linear.dense_structures import (
    add_dense_gradient,
    add_dense_gradients,
    evaluate_structure,
    is_share_known,
    spread_population,
)
from pymc_features.simulators.linear.projection import to_parameters
from pymc_features.simulators.linear.system import solved, solved_alone
from pymc_features.simulators.oscillators.misfit import weigh_history


def linear_response_gradient(parameters, excitation, wanted, cotangent) -> tuple:
    """Gradient of sum_jk W_jk y_jk, W the cotangent (s, u).

    Returns
    -------
    tuple of arrays (p,), (2,), (k,)
        By theta, rayleigh and ratios; NaN where they describe no structure. With a matrix for damping the
        last two are zero.

    Notes
    -----
    Exact, at repeated frequencies and for rigid bodies too; not where `n_modes` cuts a pair of equal
    frequencies, nor where damping ratios that differ from mode to mode change places.
    """
    a = Arguments(parameters, excitation, wanted)
    a.check(cotangent)
    return gradient(a, cotangent, None)


def linear_misfit_gradient(parameters, excitation, wanted, observed, weights) -> tuple:
    """Gradient of sum_ji c_ji times the statistics of the misfit; data (s, u), weights c (s, 1) or (s, 4).

    One column weighs e_j alone, four all that `linear_misfit` returns. Returns as `linear_response_gradient`.
    Memory: a few blocks of samples; of modes that the damping couples also the response, and their states at
    all steps.
    """
    a = Arguments(parameters, excitation, wanted)
    a.check(observed, weights)
    return gradient(a, observed, weights)


def linear_population_gradient(parameters, excitation, wanted, observed, weights) -> tuple:
    """Gradient of the weighted statistics of a population; data (s, u), weights c (p, s, 1) or (p, s, 4).

    theta, rayleigh and ratios have one more axis in front. Returns arrays of their shapes; what all particles
    share, in one row, gets the sum. Dense structures stay in compiled code, but for those with a matrix for
    damping whose complex modes are close.
    """
    count = n_particles(parameters, weights)
    sums = tuple(np.zeros(array.shape) for array in parameters.random)
    a, first = Arguments(parameters, excitation, wanted), parameters.one_of(0)
    a._replace(parameters=first).check(observed, weights[0])
    if first.is_dense and first.is_classical:
        kernel = parameters.for_kernel()
        if weights.shape[2] == 1:
            data = writable(observed), writable(weights)
            add_dense_gradients(kernel, a.inputs, a.outputs, *data, sums)
            return sums
        for p in range(count):
            one, part = kernel.one_of(p).as_population(), tuple(x[p % len(x)][None] for x in sums)
            add_alone(a, one, observed, weights[p], part)
        return sums
    is_done = np.zeros(count, dtype=bool)
    if in_complex_modes(a._replace(parameters=first), weights):
        data = writable(observed), writable(weights)
        is_done = add_coupled_gradients(parameters.for_kernel(), a.inputs, a.outputs, *data, sums[0])
    for p, own, system in solved(a, np.flatnonzero(~is_done), left_out=True):
        for total, part in zip(sums, gradient_of(own, system, observed, weights[p]), strict=True):
            total[p % total.shape[0]] += part
    return sums


def linear_gradient_of_sums(parameters, excitation, wanted, sums) -> tuple:
    """Gradients of a population of which the sums over time are known, see `reduction.derive_from`.

    Dense structures with classical damping under one input, without close modes. Parameters and results as in
    `linear_population_gradient`.
    """
    a, totals = Arguments(parameters, excitation, wanted), tuple(map(np.zeros_like, parameters.random))
    spread_population(parameters.for_kernel(), a.inputs, a.outputs, sums, totals)
    return totals


def in_complex_modes(a, weights) -> bool:
    """Whether complex modes in lanes give the gradient by weights (..., s, 1 or 4)."""
    is_whole = a.wanted.n_modes == a.parameters.n_dof and weights.shape[-1] == 1
    is_known = a.excitation.direct.size == 0 or is_share_known(a.parameters, a.wanted)
    return is_whole and is_known and a.has_pairs


def add_alone(a, kernel, history, weights, sums):
    """Add the gradient of a population of one dense structure by sum w y, w the history, or by the misfit.

    The latter by e_j alone, weights (s, 1), or by all statistics (s, 4), from its response.
    """
    history, is_given = writable(history), weights is None or weights.shape[1] > 1
    if weights is None:
        weights = np.zeros((len(history), 1))
    elif is_given:
        data, history = history, np.empty(history.shape)
        evaluate_structure(kernel, a.inputs, a.outputs, data, history)
        weigh_history(history, data, writable(weights))
    factors = writable(weights[None, :, :1])
    add_dense_gradient(kernel, a.inputs, a.outputs, history, factors, is_given, sums)


def gradient(a, history, weights):
    """Gradient of sum w y, w the `history`, or of the misfit's statistics with `weights` and the data."""
    given = a.parameters
    sums, kernel = tuple(np.zeros(array.shape) for array in given.random), given.as_population().for_kernel()
    each = tuple(total[None] for total in sums)
    if given.is_dense and given.is_classical:
        add_alone(a, kernel, history, weights, each)
        return sums
    if weights is not None and in_complex_modes(a, weights):
        data = writable(history), writable(weights[None])
        if add_coupled_gradients(kernel, a.inputs, a.outputs, *data, each[0])[0]:
            return sums
    return gradient_of(*solved_alone(a, left_out=True), history, weights)


def gradient_of(a, system, history, weights):
    """Gradient of a structure whose modes are known; None for no structure."""
    if system is None:
        return tuple(np.full(array.shape, np.nan) for array in a.parameters.random)
    route = oscillators if a.parameters.is_classical else state_space
    return to_parameters(a, system, route.pull_back(a, system, history, weights))
