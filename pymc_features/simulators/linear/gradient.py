"""Gradients of response and discrepancy of linear structures by theta, Rayleigh pair and damping ratios.

The parameters of all functions are those of `Arguments`, in their order, and what else is said. The cost
does not grow with the number of parameters but for one product with the stacks of their entries.
"""

import numpy as np

from pymc_features.simulators.linear import oscillators, state_adjoint
from pymc_features.simulators.linear.arguments import N_PARAMETERS, Arguments, n_particles, one_of
from pymc_features.simulators.linear.projection import to_parameters
from pymc_features.simulators.linear.system import solve_system


def linear_response_gradient(parameters, excitation, wanted, cotangent) -> tuple:
    """Gradient of sum_jk W_jk y_jk, W the cotangent (s, u) that follows the arguments.

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
    a = Arguments(*parameters, *excitation, *wanted)
    a.check(cotangent)
    return gradient(a, cotangent, np.zeros(0))


def linear_discrepancy_gradient(parameters, excitation, wanted, observed, weights) -> tuple:
    """Gradient of sum_j c_j e_j; data (s, u) and weights c (s,) follow the arguments.

    Returns as `linear_response_gradient`. Memory: a few blocks of 128 samples; of modes that the damping
    couples also their state at every 128th step.
    """
    a = Arguments(*parameters, *excitation, *wanted)
    a.check(observed, weights)
    return gradient(a, observed, weights)


def linear_population_gradient(parameters, excitation, wanted, observed, weights) -> tuple:
    """Gradient of sum_pj c_pj e_pj of a population; data (s, u) and weights c (p, s) follow the arguments.

    theta, rayleigh and ratios have one more axis in front. Returns arrays of their shapes; what all particles
    share, in one row, gets the sum.
    """
    parameters, rest = parameters[:N_PARAMETERS], (*parameters[N_PARAMETERS:], *excitation, *wanted)
    count = n_particles(parameters, weights)
    sums = tuple(np.zeros(array.shape) for array in parameters)
    for p in range(count):
        a = Arguments(*one_of(parameters, p), *rest)
        a.check(observed, weights[p])
        for total, own in zip(sums, gradient(a, observed, weights[p]), strict=True):
            total[p % total.shape[0]] += own
    return sums


def gradient(a, history, weights):
    """Gradient of sum w y, w the `history`, or of sum_j c_j e_j with `weights` c and the data."""
    system = solve_system(a, left_out=True)
    if system is None:
        return tuple(np.full(array.shape, np.nan) for array in a[:N_PARAMETERS])
    route = oscillators if a.is_classical else state_adjoint
    return to_parameters(a, system, route.pull_back(a, system, history, weights))
