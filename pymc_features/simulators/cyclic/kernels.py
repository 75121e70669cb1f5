"""The functions of the family of specimens; each takes NumPy arrays and runs compiled code.

A population is a loop over its particles, for each of which the history of the force is kept, and with a
gradient its derivatives by the fourteen parameters. That costs some 3 microseconds for each displacement, and
three times as much with the gradient.
"""

import numpy as np

from pymc_features.simulators.cyclic.law import N_PARAMETERS, SpecimenParameters
from pymc_features.simulators.cyclic.march import march
from pymc_features.simulators.oscillators.arguments import Excitation, n_outputs
from pymc_features.simulators.oscillators.misfit import measured_difference, weigh_history


def numbers(array) -> np.ndarray:
    """A copy as float64, in C order: one compiled kernel serves all arrays."""
    return np.array(array, dtype=np.float64, order="C")


def forces(law, excitation, *, with_gradient=False) -> tuple[np.ndarray, np.ndarray]:
    """Force (u,) [N] of one specimen, and its derivatives (14, u), or (0, u)."""
    law, displacement = numbers(law), numbers(excitation.acceleration)
    if law.shape != (N_PARAMETERS,):
        raise ValueError(f"`law` must have the {N_PARAMETERS} parameters of a specimen, got {law.shape}.")
    given = Excitation(displacement, *map(int, (1, excitation.substeps, excitation.stride)))
    total = n_outputs(displacement.size, given.substeps, given.stride)
    force, gradient = np.empty(total), np.empty((N_PARAMETERS if with_gradient else 0, total))
    march(law, given, force, gradient)
    return force, gradient


def at_sensors(wanted, history) -> np.ndarray:
    """The only history (..., u) as those of the sensors asked for, (..., s, u)."""
    return np.repeat(history[..., None, :], np.size(wanted.sensors), axis=-2)


def statistics(response, observed) -> np.ndarray:
    """Statistics (s, 4) of the misfit y - g, see `misfit`."""
    misfit, total = observed - response, response.shape[1]
    squares = np.square(measured_difference(response, observed)).sum(axis=1)
    increments = np.square(np.diff(misfit, axis=1)).sum(axis=1)
    return np.stack([squares / total, increments / total, misfit[:, 0], misfit[:, -1]], axis=1)


def response(parameters, excitation, wanted):
    """Force (s, u)."""
    return at_sensors(wanted, forces(parameters.law, excitation)[0])


def misfit(parameters, excitation, wanted, observed):
    """Statistics (s, 4)."""
    return statistics(response(parameters, excitation, wanted), checked(observed, excitation, wanted))


def population_misfit(parameters, excitation, wanted, observed):
    """Statistics (p, s, 4)."""
    return np.stack([misfit(SpecimenParameters(row), excitation, wanted, observed) for row in parameters.law])


def checked(history, excitation, wanted) -> np.ndarray:
    """Data or a cotangent, if it has the shape of the response."""
    size = np.shape(excitation.acceleration)[-1]
    expected = np.size(wanted.sensors), n_outputs(size, int(excitation.substeps), int(excitation.stride))
    if np.shape(history) != expected:
        raise ValueError(
            "`observed`, or the cotangent, must have the shape (sensor, time) of the response, "
            f"{expected}, got {np.shape(history)}."
        )
    return numbers(history)


def response_gradient(parameters, excitation, wanted, cotangent):
    """Gradient of sum_jk W_jk y_jk."""
    _, gradient = forces(parameters.law, excitation, with_gradient=True)
    return SpecimenParameters(gradient @ checked(cotangent, excitation, wanted).sum(axis=0))


def misfit_gradient(parameters, excitation, wanted, observed, weights):
    """Gradient of sum_jq c_jq times the statistics."""
    force, gradient = forces(parameters.law, excitation, with_gradient=True)
    cotangent = at_sensors(wanted, force)
    weigh_history(cotangent, checked(observed, excitation, wanted), numbers(weights))
    return SpecimenParameters(gradient @ cotangent.sum(axis=0))


def population_gradient(parameters, excitation, wanted, observed, weights):
    """Gradients (p, 14), or their sum (1, 14) where all particles share the parameters."""
    law, rows = parameters.law, []
    for k, own in enumerate(weights):
        specimen = SpecimenParameters(law[k % len(law)])
        rows.append(misfit_gradient(specimen, excitation, wanted, observed, own).law)
    return SpecimenParameters(np.stack(rows) if len(law) > 1 else np.sum(rows, axis=0, keepdims=True))


def response_tangent(parameters, excitation, wanted, directions):
    """Derivative (s, u) along a direction."""
    _, gradient = forces(parameters.law, excitation, with_gradient=True)
    return at_sensors(wanted, numbers(directions[0]) @ gradient)


def discrepancy_tangent(parameters, excitation, wanted, observed, directions):
    """Derivative (s,) of the mean squares along a direction."""
    force, gradient = forces(parameters.law, excitation, with_gradient=True)
    observed = checked(observed, excitation, wanted)
    difference = measured_difference(at_sensors(wanted, force), observed)
    return 2.0 * (difference * (numbers(directions[0]) @ gradient)).mean(axis=1)


KERNELS = {
    "response": response,
    "discrepancy": lambda *given: misfit(*given)[:, 0],
    "misfit": misfit,
    "response_gradient": response_gradient,
    "misfit_gradient": misfit_gradient,
    "response_tangent": response_tangent,
    "discrepancy_tangent": discrepancy_tangent,
    "population_discrepancy": lambda *given: population_misfit(*given)[..., 0],
    "population_misfit": population_misfit,
    "population_gradient": population_gradient,
}
