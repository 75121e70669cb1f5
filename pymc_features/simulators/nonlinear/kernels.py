"""The functions of a family of nonlinear chains, with the arguments that all families share.

`n_modes` is the number of degrees of freedom.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.nonlinear.discrepancy import misfit_kernel
from pymc_features.simulators.nonlinear.gradient import gradient_kernel
from pymc_features.simulators.nonlinear.response import arguments, in_memory, nonlinear_response
from pymc_features.simulators.nonlinear.step_tangent import derivative_memory
from pymc_features.simulators.nonlinear.tangent import tangent_kernel
from pymc_features.simulators.nonlinear.tape import Tape, record_size, tape_memory

NO_DATA = np.empty((0, 0))


class NonlinearParameters(NamedTuple):
    """As `ChainParameters`, and `law` (rows, n): the parameters of the law of each spring."""

    mass: np.ndarray
    stiffness: np.ndarray
    rayleigh: np.ndarray
    ratios: np.ndarray
    law: np.ndarray


def plain(array):
    """A copy in the type for which the kernels are compiled."""
    return np.array(array, dtype=np.float64)


def nonlinear_kernels(law) -> dict:
    """Return the functions of a law of `law.LAWS` by name.

    Each is called from Python and runs compiled code; what surrounds that takes some 20 microseconds. NaN
    where the parameters describe no structure or the integration fails.
    """

    def call(kernel, parameters, excitation, wanted, *more):
        sensors, n_modes, quantity = wanted
        settings = arguments(parameters, *excitation, sensors, n_modes)
        return in_memory(law, kernel, *settings, int(quantity), *more)

    def differentiate(kernel, parameters, excitation, wanted, *more):
        n = np.shape(parameters[0])[-1]
        work, tape = derivative_memory(n), tape_memory(n)
        memory = work.ctypes.data, Tape(tape.ctypes.data, record_size(n))
        return call(kernel, parameters, excitation, wanted, *more, *memory)

    def alone(parameters):
        return NonlinearParameters(*(plain(p)[None] for p in parameters))

    def population_misfit(parameters, excitation, wanted, observed):
        return call(misfit_kernel, parameters, excitation, wanted, plain(observed))

    def misfit(parameters, excitation, wanted, observed):
        return population_misfit(alone(parameters), excitation, wanted, observed)[0]

    def population_gradient(parameters, excitation, wanted, observed, weights):
        history, weights = plain(observed), plain(weights)
        return differentiate(gradient_kernel, parameters, excitation, wanted, history, weights)

    def discrepancy_gradient(parameters, excitation, wanted, observed, weights):
        rows = plain(weights)[None]
        return tuple(g[0] for g in population_gradient(alone(parameters), excitation, wanted, observed, rows))

    def response_gradient(parameters, excitation, wanted, cotangent):
        return discrepancy_gradient(parameters, excitation, wanted, cotangent, [])

    def tangent(parameters, excitation, wanted, observed, directions):
        directions = tuple(map(plain, directions))
        return differentiate(tangent_kernel, parameters, excitation, wanted, observed, directions)

    def response_tangent(parameters, excitation, wanted, directions):
        return tangent(parameters, excitation, wanted, NO_DATA, directions)

    def discrepancy_tangent(parameters, excitation, wanted, observed, directions):
        return tangent(parameters, excitation, wanted, plain(observed), directions)[:, 0]

    return {
        "response": nonlinear_response(law),
        "discrepancy": lambda *given: misfit(*given)[:, 0],
        "misfit": misfit,
        "response_gradient": response_gradient,
        "discrepancy_gradient": discrepancy_gradient,
        "response_tangent": response_tangent,
        "discrepancy_tangent": discrepancy_tangent,
        "population_discrepancy": lambda *given: population_misfit(*given)[..., 0],
        "population_misfit": population_misfit,
        "population_gradient": population_gradient,
    }
