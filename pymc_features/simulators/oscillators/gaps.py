"""Blocks of data with gaps: what was not measured is not compared."""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import load, splat, store
from pymc_features.simulators.oscillators.lanes import SAMPLES


@jit
def is_whole(observed, first, count):
    """Whether a block of data (sensors, time) has no gap."""
    for j in range(observed.shape[0]):
        for k in range(first, first + count):
            if observed[j, k] != observed[j, k]:
                return False
    return True


@jit
def add_measured_squares(lanes, observed, first, count, ground, step, stride):
    """Add the squared misfits of those of `count` samples, from `first` on, that were measured."""
    n_modes = lanes.outputs.shape[0] // SAMPLES
    for j in range(observed.shape[0]):
        total, feed = load(lanes.squares, j), load(lanes.feed, j)
        for t in range(count):
            value = observed[j, first + t]
            if value == value:
                misfit = splat(value) - feed * splat(ground[step + t * stride])
                for r in range(n_modes):
                    misfit = misfit - load(lanes.shapes, j * n_modes + r) * load(
                        lanes.outputs, SAMPLES * r + t
                    )
                total = total + misfit * misfit
        store(lanes.squares, j, total)
