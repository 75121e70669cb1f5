"""Gradients of a population of chains, `LANES` at a time."""

import numpy as np

from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.taylor.adjoint.parameters import ChainBars, parameter_gradients
from pymc_features.simulators.taylor.adjoint.sweep import GradientLanes
from pymc_features.simulators.taylor.population import groups_of, rows_of
from pymc_features.simulators.taylor.tape import tape_memory


def add_gradients(kernels, lanes, parameters, members, problem, weights, gradients):
    """Add the gradients of particles, sums where they share a row; return those lost, with neighbours.

    Parameters
    ----------
    kernels : pair of callable
        Compiled: a march, as of `march_population`, and the sweep back.
    lanes, parameters, members, problem
        As of `march_population`.
    weights : array (p, s, q)
        Of the statistics.
    gradients : tuple of array
        In the shapes of the parameters.
    """
    march, sweep = kernels
    ground, wanted, observed = problem
    tape = tape_memory(lanes.series, lanes.n, ground.n_steps, *observed.shape)
    memory = GradientLanes(lanes, len(observed), weights.shape[2])
    lost, done, bars = [], [], []
    for own in groups_of(members):
        chains = rows_of(parameters, np.resize(own, LANES))
        tape.clear()
        spans = lanes.march(march, chains, problem, tape.tape)
        if lanes.lost.any():  # the steps of its neighbours went by it
            lost.append(own)
            continue
        memory.clear(weights[np.resize(own, LANES)])
        step = sweep(lanes.group, memory.memory, tape.tape, spans, wanted, observed)
        bars.append(ChainBars(*(x[: len(own)] for x in memory.take(step))))
        done.append(own)
    tape.keep()
    if done:
        done = np.concatenate(done)
        bars = ChainBars(*map(np.concatenate, zip(*bars, strict=True)))
        found = parameter_gradients(lanes.series, rows_of(parameters, done), bars)
        for total, gradient in zip(gradients, found, strict=True):
            np.add.at(total, done % len(total), gradient)
    return np.concatenate(lost) if lost else members[:0]
