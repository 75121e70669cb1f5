"""The functions of a family of nonlinear chains, with the arguments that all families share.

    kernel(mass, stiffness, rayleigh, ratios, values, acceleration, dt, substeps, stride, sensors, n_modes,
           quantity, *more)

with the law's table `values` (rows, n), everything else as of the linear chain's kernels. `n_modes` is the
number of degrees of freedom.
"""

import numpy as np

from pymc_features.simulators.nonlinear.discrepancy import misfit_kernel
from pymc_features.simulators.nonlinear.gradient import gradient_kernel
from pymc_features.simulators.nonlinear.response import arguments, in_memory, nonlinear_response
from pymc_features.simulators.nonlinear.step_tangent import derivative_memory
from pymc_features.simulators.nonlinear.tangent import tangent_kernel
from pymc_features.simulators.nonlinear.tape import Tape, record_size, tape_memory

NO_DATA = np.empty((0, 0))


def plain(array):
    """A copy in the type for which the kernels are compiled."""
    return np.array(array, dtype=np.float64)


def nonlinear_kernels(law) -> dict:
    """Return the functions of a law of `restoring.LAWS` by name.

    Each is called from Python and runs compiled code; what surrounds that takes some 20 microseconds. NaN
    where the parameters describe no structure or the integration fails.
    """

    def call(kernel, given, *more):
        parameters, settings, quantity = given[:5], given[5:-1], given[-1]
        return in_memory(law, kernel, *arguments(parameters, *settings), int(quantity), *more)

    def differentiate(kernel, given, *more):
        n = np.shape(given[0])[-1]
        work, tape = derivative_memory(n), tape_memory(n)
        return call(kernel, given, *more, work.ctypes.data, Tape(tape.ctypes.data, record_size(n)))

    def gradient(given, history, weights):
        one = [plain(p)[None] for p in given[:5]] + given[5:]
        return tuple(g[0] for g in differentiate(gradient_kernel, one, plain(history), plain(weights)[None]))

    def population_misfit(*given):
        *given, observed = given
        return call(misfit_kernel, given, plain(observed))

    def misfit(*given):
        one = [plain(p)[None] for p in given[:5]]
        return population_misfit(*one, *given[5:])[0]

    def response_gradient(*given):
        *given, cotangent = given
        return gradient(given, cotangent, [])

    def discrepancy_gradient(*given):
        *given, observed, weights = given
        return gradient(given, observed, weights)

    def population_gradient(*given):
        *given, observed, weights = given
        return differentiate(gradient_kernel, given, plain(observed), plain(weights))

    def response_tangent(*given):
        given, directions = given[:-5], tuple(map(plain, given[-5:]))
        return differentiate(tangent_kernel, given, NO_DATA, directions)

    def discrepancy_tangent(*given):
        (*given, observed), directions = given[:-5], tuple(map(plain, given[-5:]))
        return differentiate(tangent_kernel, given, plain(observed), directions)[:, 0]

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
