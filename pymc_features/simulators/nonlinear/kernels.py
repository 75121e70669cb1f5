"""The functions of a family of nonlinear chains; each takes NumPy arrays and runs compiled code.

`n_modes` is the number of degrees of freedom. What surrounds a kernel takes some 20 microseconds.
"""

from collections import Counter
from functools import cached_property

import numpy as np

from pymc_features.simulators.nonlinear.law import (
    LAWS,
    NonlinearParameters,
    chain_memory,
    check_history,
    check_parameters,
    n_particles,
    padded,
    particle,
)
from pymc_features.simulators.nonlinear.marches import (
    history_kernel,
    march_kernel,
    sweep_kernel,
)
from pymc_features.simulators.numbers.vectors import LANES
from pymc_features.simulators.oscillators.arguments import (
    RELATIVE_ACCELERATION,
    Excitation,
    Outputs,
    excess_of,
    n_outputs,
)
from pymc_features.simulators.oscillators.differences import WITH_KINKS, gradient, tangents
from pymc_features.simulators.oscillators.misfit import statistics, weigh_history
from pymc_features.simulators.taylor.adjoint.sweep import add_gradients
from pymc_features.simulators.taylor.ground import ground_of
from pymc_features.simulators.taylor.population import Lanes, is_linear_chain, march_population

PARTICLES = Counter()  # evaluated in populations by Taylor steps, by Runge-Kutta steps, and by both


def numbers(array) -> np.ndarray:
    """A copy as float64, in C order: one compiled kernel serves all arrays."""
    return np.array(array, dtype=np.float64, order="C")


def one_particle(parameters) -> NonlinearParameters:
    """The parameters of one chain as those of a population."""
    return NonlinearParameters(*(np.asarray(p)[None] for p in parameters))


class Problem:
    """A chain, or a population of them, with memory to integrate in.

    Parameters
    ----------
    law : type
        One of `law.LAWS`.
    parameters, excitation, wanted : NonlinearParameters, Excitation, Outputs
        As of the family's functions; checked, and in the types for which the kernels are compiled.
    """

    def __init__(self, law, parameters, excitation, wanted):
        acceleration, dt, substeps, stride, direct = excitation
        sensors, n_modes, quantity = wanted
        self.parameters = NonlinearParameters(*map(numbers, parameters))
        grid = float(dt), int(substeps), int(stride)
        self.excitation = Excitation(numbers(acceleration), *grid, numbers(direct))
        self.wanted = Outputs(np.array(sensors, dtype=np.int64), int(n_modes), int(quantity))
        check_parameters(law, self.parameters, self.wanted)
        self.n = self.parameters.mass.shape[-1]
        self.n_outputs = n_outputs(len(self.excitation.acceleration), substeps, stride)
        excess = excess_of(self.excitation, self.n_outputs)
        self.excess = excess if excess.size else np.zeros(self.n_outputs)
        self.law = law

    @cached_property
    def memory(self) -> np.ndarray:
        """Memory in which Runge-Kutta steps are taken: kept as long as the address below is used."""
        return chain_memory(self.n)

    @property
    def chain(self):
        """The chain as the kernels of Runge-Kutta steps take it."""
        return self.law(self.memory.ctypes.data, padded(self.n) // LANES, self.n)

    def history(self, history) -> np.ndarray:
        """Data or a cotangent, checked to have the shape of the response."""
        return check_history(numbers(history), (self.wanted.sensors.size, self.n_outputs))

    def data(self, observed) -> np.ndarray:
        """Data (s, u) as the kernels take them, which know the prepared record only."""
        is_relative = self.wanted.quantity == RELATIVE_ACCELERATION
        return observed + self.excess if is_relative else observed

    def response(self, parameters, quantities, refine=1) -> np.ndarray:
        """Histories (quantity, sensor, time) of a chain."""
        codes, sensors = np.array(quantities, dtype=np.int64), self.wanted.sensors
        found = history_kernel(self.chain, parameters, self.excitation, sensors, codes, float(refine))
        found[codes == RELATIVE_ACCELERATION] -= self.excess
        return found

    def gradient(self, parameters, sought, cotangent_of) -> NonlinearParameters:
        """Gradient of sum_jk W_jk y_jk for one chain; `cotangent_of` makes W (s, u) of its response."""

        def response(moved):
            return self.response(moved, [self.wanted.quantity])[0]

        middle = response(parameters)
        return gradient(response, parameters, sought, middle, cotangent_of(middle.copy()))


def nonlinear_histories(law, parameters, excitation, sensors, quantities, refine=1) -> np.ndarray:
    """Histories (quantity, sensor, time) of a chain.

    Parameters
    ----------
    law : type
        One of `law.LAWS`.
    parameters : NonlinearParameters
        Or a tuple in its order.
    excitation : Excitation
    sensors, quantities : array_like of int
        Degrees of freedom; codes of `QUANTITIES` and of `response`.
    refine : int
        Number of parts into which every step is divided.
    """
    problem = Problem(law, parameters, excitation, Outputs(sensors, len(parameters[0]), 0))
    return problem.response(problem.parameters, quantities, refine)


def one_by_one(problem, particles, observed) -> np.ndarray:
    """Statistics (p, s, 4) of some particles, from histories by Runge-Kutta steps in vectors of springs."""
    code = [problem.wanted.quantity]
    histories = (problem.response(particle(problem.parameters, k), code)[0] for k in particles)
    return np.array([statistics(history, observed) for history in histories])


def has_reverse(series, parameters, sought):
    """Whether a recurrence has all derivatives that are wanted.

    Where nothing is said of that, one by a parameter that has other values in other particles is.
    """
    if series.adjoint is None:
        return False
    if sought is not None:
        return not any(f"law[{row}]" in sought or "law" in sought for row, _ in series.adjoint.fixed)
    return all(np.isin(parameters.law[:, row], values).all() for row, values in series.adjoint.fixed)


def taylor_groups(problem, recurrences):
    """Recurrences and the particles that each of them serves; what none of them serves is left to others."""
    parameters = problem.parameters
    left = np.ones(n_particles(parameters), dtype=bool) & is_linear_chain(parameters)
    for group, series in recurrences:
        members = left & series.serves(parameters.law.swapaxes(0, 1)).all(axis=-1)
        if members.any():
            has_modal_damping = bool(parameters.ratios.any())
            lanes = Lanes(group, series, problem.n, problem.wanted.sensors.size, has_modal_damping)
            yield lanes, np.flatnonzero(members)
        left &= ~members


def population_statistics(law, problem, observed) -> np.ndarray:
    """Statistics (p, s, 4) of particles by Taylor steps, vectors of particles, and of the others one by one.

    The others are those that no recurrence of the law serves, that are no structure, and that were lost.
    """
    parameters, count = problem.parameters, n_particles(problem.parameters)
    result = np.empty((count, problem.wanted.sensors.size, 4))
    left = np.ones(count, dtype=bool)
    given = ground_of(problem.excitation), problem.wanted, problem.data(observed)
    for lanes, members in taylor_groups(problem, LAWS[law].series.items()):
        lost = march_population(march_kernel, lanes, parameters, members, given, result)
        left[members] = False
        left[lost] = True
        PARTICLES["taylor"] += members.size
        PARTICLES["lost"] += lost.size
    others = np.flatnonzero(left)
    if others.size:
        result[others] = one_by_one(problem, others, observed)
        PARTICLES["runge_kutta"] += others.size
    return result


def add_taylor_gradients(law, problem, sought, observed, weights, gradients) -> np.ndarray:
    """Add the gradients of particles by Taylor steps; return the particles that are left to others."""
    parameters, count = problem.parameters, n_particles(problem.parameters)
    left = np.ones(count, dtype=bool)
    given = ground_of(problem.excitation), problem.wanted, observed
    kernels = march_kernel, sweep_kernel
    reversible = [pair for pair in LAWS[law].series.items() if has_reverse(pair[1], parameters, sought)]
    for lanes, members in taylor_groups(problem, reversible):
        lost = add_gradients(kernels, lanes, parameters, members, given, weights, gradients)
        left[members] = False
        left[lost] = True
        PARTICLES["taylor gradients"] += members.size - lost.size
    return np.flatnonzero(left)


def nonlinear_kernels(law) -> dict:
    """Return the functions of a law of `law.LAWS` by name, as `families` describes them.

    NaN where the parameters describe no structure or the integration fails.
    """

    def response(parameters, excitation, wanted):
        problem = Problem(law, parameters, excitation, wanted)
        return problem.response(problem.parameters, [wanted.quantity])[0]

    def population_misfit(parameters, excitation, wanted, observed):
        problem = Problem(law, parameters, excitation, wanted)
        return population_statistics(law, problem, problem.history(observed))

    def misfit(parameters, *given):
        return population_misfit(one_particle(parameters), *given)[0]

    def response_gradient(parameters, excitation, wanted, cotangent, sought=None):
        problem = Problem(law, parameters, excitation, wanted)
        cotangent = problem.history(cotangent)
        return problem.gradient(problem.parameters, sought, lambda response: cotangent)

    def population_gradient(parameters, excitation, wanted, observed, weights, sought=None):
        problem = Problem(law, parameters, excitation, wanted)
        observed, weights = problem.history(observed), numbers(weights)
        expected = (n_particles(problem.parameters), len(observed))
        if weights.shape not in ((*expected, 1), (*expected, 4)):
            raise ValueError(
                f"`weights` must have the shape {(*expected, '1 or 4')} (particle, sensor, statistic), "
                f"got {weights.shape}."
            )
        gradients = NonlinearParameters(*(np.zeros(p.shape) for p in problem.parameters))
        for k in add_taylor_gradients(law, problem, sought, problem.data(observed), weights, gradients):

            def cotangent_of(response, c=weights[k]):
                weigh_history(response, observed, c)
                return response

            own = problem.gradient(particle(problem.parameters, k), sought, cotangent_of)
            for total, part in zip(gradients, own, strict=True):
                total[k % len(total)] += part  # what all particles share gets the sum
        return gradients

    def misfit_gradient(parameters, excitation, wanted, observed, weights, sought=None):
        given = excitation, wanted, observed, numbers(weights)[None], sought
        return NonlinearParameters(*(g[0] for g in population_gradient(one_particle(parameters), *given)))

    return {
        "response": response,
        "discrepancy": lambda *given: misfit(*given)[:, 0],
        "misfit": misfit,
        "response_gradient": response_gradient,
        "misfit_gradient": misfit_gradient,
        **tangents(response, len(NonlinearParameters._fields), WITH_KINKS),
        "population_discrepancy": lambda *given: population_misfit(*given)[..., 0],
        "population_misfit": population_misfit,
        "population_gradient": population_gradient,
    }
