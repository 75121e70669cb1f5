"""Statistics of the misfit between data and the response of a nonlinear chain; no history is kept.

Of r = data - response at N samples: the mean of r_k^2, the sum of (r_k - r_{k-1})^2 over N, r_0 and r_{N-1},
of each sensor.
"""

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.nonlinear.parameters import particle
from pymc_features.simulators.nonlinear.response import begin, next_sample, write_outputs
from pymc_features.simulators.nonlinear.state import prepare
from pymc_features.simulators.oscillators.arguments import ground_at


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
