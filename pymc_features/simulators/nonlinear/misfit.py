"""Statistics of the misfit between data and the response of a nonlinear chain, and their derivative.

Of r = data - response at N_D samples: the mean of r_k^2, the sum of (r_k - r_{k-1})^2 over N_D, r_0 and
r_{N-1}, of each sensor. The values need no history.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.nonlinear.parameters import particle
from pymc_features.simulators.nonlinear.response import begin, ground_at, next_sample, write_outputs
from pymc_features.simulators.nonlinear.state import prepare


@jit
def march_misfit(law, parameters, excitation, wanted, observed, result):
    """Write the statistics of one chain, as of `chain_misfit`, into `result` (s, 4)."""
    total = observed.shape[1]
    sensors = wanted.sensors
    result[:] = 0.0
    valid = prepare(law, parameters, 1.0)
    begin(law, excitation, 0)
    outputs = np.empty(sensors.size)
    for sample in range(total):
        if sample > 0 and valid:
            valid = next_sample(law, excitation, sample - 1, None)
        if not valid:
            result[:] = np.nan
            return
        ground = ground_at(excitation.acceleration, sample * excitation.stride, excitation.substeps)
        write_outputs(law, ground, wanted.quantity, sensors, outputs)
        for j in range(sensors.size):
            misfit = observed[j, sample] - outputs[j]
            result[j, 0] += misfit * misfit / total
            if sample == 0:
                result[j, 2] = misfit
            else:
                result[j, 1] += (misfit - result[j, 3]) ** 2 / total
            result[j, 3] = misfit


@jit
def misfit_kernel(law, parameters, excitation, wanted, observed, result):
    """Write the statistics (p, s, 4) of particles, one after the other in the same memory.

    Vectors hold springs, not particles: each particle has steps of its own, which follow its state and end at
    its kinks, and in lockstep all would take the steps of the most demanding one and stop at every kink.
    """
    for k in range(result.shape[0]):
        march_misfit(law, particle(parameters, k), excitation, wanted, observed, result[k])


def response_cotangent(misfit, weights):
    """Derivative (s, u) by the response of the sum of weights (s, q) times the first q statistics.

    L = c_0 sum_k r_k^2 / N + c_1 sum_k (r_k - r_{k-1})^2 / N + c_2 r_0 + c_3 r_{N-1}, dL/dy = -dL/dr.
    """
    c = np.zeros((len(misfit), 4))
    c[:, : weights.shape[1]] = weights
    increments = c[:, 1:2] * np.diff(misfit, axis=1)
    by_misfit = c[:, :1] * misfit
    by_misfit[:, 1:] += increments
    by_misfit[:, :-1] -= increments
    by_misfit *= 2.0 / misfit.shape[1]
    by_misfit[:, 0] += c[:, 2]
    by_misfit[:, -1] += c[:, 3]
    return -by_misfit
