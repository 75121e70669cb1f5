"""Mean squares of the misfit between data and the response of a nonlinear chain, Eq. (3): no history."""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.nonlinear.response import (
    begin,
    check_parameters,
    ground_at,
    next_sample,
    write_outputs,
)
from pymc_features.simulators.nonlinear.state import prepare
from pymc_features.simulators.oscillators.arguments import n_outputs


@jit
def check_observed(observed, sensors, total):
    """Refuse data of another shape than the response's."""
    if observed.shape[0] != sensors.size or observed.shape[1] != total:
        raise ValueError("`observed` or the cotangent must have the shape (sensor, time) of the response")


@jit
def march_misfit(law, parameters, acceleration, sampling, sensors, quantity, observed, result):
    """Write the sums of one chain, as of `discrepancy.chain_misfit`, into `result` (s, 4)."""
    total = observed.shape[1]
    result[:] = 0.0
    valid = prepare(law, parameters, 1.0)
    begin(law, acceleration, sampling, 0)
    outputs = np.empty(sensors.size)
    for sample in range(total):
        if sample > 0 and valid:
            valid = next_sample(law, acceleration, sampling, sample - 1, None)
        if not valid:
            result[:] = np.nan
            return
        ground = ground_at(acceleration, sample * sampling[2], sampling[1])
        write_outputs(law, ground, quantity, sensors, outputs)
        for j in range(sensors.size):
            misfit = observed[j, sample] - outputs[j]
            result[j, 0] += misfit * misfit / total
            if sample == 0:
                result[j, 2] = misfit
            else:
                result[j, 1] += (misfit - result[j, 3]) ** 2 / total
            result[j, 3] = misfit


@jit
def particle(parameters, k):
    """Parameters of particle `k` of a population, each with a row for it or one for all."""
    mass, stiffness, rayleigh, ratios, values = parameters
    return (
        *(mass[k % mass.shape[0]], stiffness[k % stiffness.shape[0]], rayleigh[k % rayleigh.shape[0]]),
        *(ratios[k % ratios.shape[0]], values[k % values.shape[0]]),
    )


@jit
def n_particles(parameters):
    """Number of particles of a population."""
    mass, stiffness, rayleigh, ratios, values = parameters
    sizes = (mass.shape[0], stiffness.shape[0], rayleigh.shape[0], ratios.shape[0], values.shape[0])
    largest = max(sizes)
    for size in sizes:
        if size != 1 and size != largest:
            raise ValueError("all parameters must have one row, or one for each particle")
    return largest


@jit
def misfit_kernel(law, parameters, acceleration, dt, substeps, stride, sensors, n_modes, quantity, observed):
    """As `population.population_misfit`, (p, s, 4): particles one after the other in the same memory.

    Vectors hold springs, not particles: each particle has steps of its own, which follow its state and end at
    its kinks, and in lockstep all would take the steps of the most demanding one and stop at every kink.
    """
    check_parameters(law, particle(parameters, 0), sensors, n_modes)
    check_observed(observed, sensors, n_outputs(acceleration.size, substeps, stride))
    result = np.empty((n_particles(parameters), sensors.size, 4))
    sampling = (dt, substeps, stride)
    for k in range(result.shape[0]):
        own = particle(parameters, k)
        march_misfit(law, own, acceleration, sampling, sensors, quantity, observed, result[k])
    return result
