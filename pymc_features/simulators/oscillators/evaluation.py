"""Statistics of misfits, and responses, of structures in lanes."""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import new_quadratic
from pymc_features.simulators.numbers.rows import view
from pymc_features.simulators.oscillators.arguments import Excitation
from pymc_features.simulators.oscillators.march import GROUP, march, new_oscillators
from pymc_features.simulators.oscillators.modal_lanes import write_oscillators
from pymc_features.simulators.oscillators.samples import gathered, new_samples


class Walk(NamedTuple):
    """Structures in lanes on their way through a record; `observed` are data (s, u), or none (0, 0)."""

    modes: object
    arrays: object
    samples: object
    sample_arrays: object
    observed: np.ndarray


@jit
def new_walk(excitation, observed, n_times, n_modes, n_sensors, widths):
    """Room for structures with so many modes, under inputs (d, t)."""
    state = new_quadratic(widths.wide, widths.wide, widths.wide)
    sample_arrays, samples = new_samples(excitation, observed, n_times, n_sensors, widths)
    arrays, modes = new_oscillators(n_modes, n_sensors, min(GROUP, n_modes), state, samples, widths)
    # reached by address
    return Walk(modes, arrays, samples, sample_arrays, np.ascontiguousarray(observed))


@jit
def evaluate(lot, walk, history, first, result, widths):
    """Write the statistics of the structures in the lanes into rows `first` ... of the result (p, s, 1 or 4).

    NaN where there is no structure. Data with gaps have the first statistic only, the others are NaN. The
    response (s, u) of one structure is written into the history instead, unless that is empty.
    """
    modes, samples, with_increments = walk.modes, walk.samples, result.shape[2] > 1
    follows = write_oscillators(modes, lot, samples, widths)
    given = samples, walk.sample_arrays, walk.observed, follows, with_increments, history
    march(modes, walk.arrays, *given)
    gathered(modes.squares, modes.sensors, view(walk.arrays.squares, widths.structure), widths.structure)
    lots, ends, s = lot.is_there.size, walk.arrays.ends, modes.sensors
    for lane in range(min(lots, result.shape[0] - first)):
        for j in range(result.shape[1]):
            own = result[first + lane, j]
            own[0] = walk.arrays.squares[j * lots + lane] / samples.n_times
            if with_increments:
                own[1] = ends[j * lots + lane] / samples.n_times
                own[2], own[3] = ends[(s + j) * lots + lane], ends[(2 * s + j) * lots + lane]
                if samples.has_gaps:
                    own[1:] = np.nan
            if not lot.is_there[lane]:
                own[:] = np.nan


@jit
def in_rows(excitation):
    """The excitation with its inputs as (d, t)."""
    acceleration, dt, substeps, stride, direct = excitation
    n_times = acceleration.shape[acceleration.ndim - 1]
    rows = acceleration.reshape(acceleration.size // n_times, n_times)
    return Excitation(rows, dt, substeps, stride, direct)
