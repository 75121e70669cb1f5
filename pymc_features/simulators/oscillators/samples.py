"""Excitation and data in blocks of rows of samples, as the march takes them.

What lies in the lanes of a vector is said by three widths, wide = structure x sample:

    structures       structure   wide   sample    march: lane =   sensors: lane =
    a population     8           8      1         structure       structure
    one              1           8      8         mode            sample

(4 where the registers hold 4 numbers.) An oscillator is a row of lanes; the march knows no structure.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import in_lanes, lanes, new_four, the_narrowed
from pymc_features.simulators.numbers.rows import moved, view, zero
from pymc_features.simulators.numbers.vectors import new_numbers
from pymc_features.simulators.oscillators.arguments import interpolate

BLOCK = 16  # rows of samples handled at a time


class Widths(NamedTuple):
    """Zeros of the width of a structure's numbers, of the march, and of the samples."""

    structure: object
    wide: object
    sample: object


@jit
def of_population():
    """`Widths` of many structures."""
    return Widths(in_lanes(0.0), in_lanes(0.0), 0.0)


@jit
def of_one():
    """`Widths` of one structure."""
    return Widths(0.0, in_lanes(0.0), in_lanes(0.0))


class SampleArrays(NamedTuple):
    """Arrays behind `Samples`; the caller keeps them."""

    steps: np.ndarray
    ground: np.ndarray
    own: np.ndarray
    data: np.ndarray
    mask: np.ndarray


class Samples(NamedTuple):
    """Inputs and data, zero behind their ends.

    Attributes
    ----------
    steps : Rows of numbers (d, step_length)
        Inputs at the steps of the recursion.
    ground : Rows of samples (d, ground_length)
        The same at the outputs.
    own : Rows of samples (orders, d, length)
        The inputs' own values at the outputs and, under band-limited inputs, four derivatives.
    is_own : bool
        Whether these differ from `ground`.
    mask : Rows of samples (s, BLOCK)
        One where there are data, in a block that `data_of` has written.
    has_gaps : bool
        Whether data are missing before the end, or there are none.
    n_blocks, n_times, size, stride, inputs, orders : int
        Blocks, samples of a sensor and of a block, and steps of the recursion between two outputs.
    """

    steps: object
    step_length: int
    ground: object
    ground_length: int
    own: object
    is_own: bool
    length: int
    mask: object
    has_gaps: bool
    n_blocks: int
    n_times: int
    size: int
    stride: int
    inputs: int
    orders: int


@jit
def even(count):
    """The next even number."""
    return count + count % 2


@jit
def copy_inputs(excitation, steps, length):
    """Write the inputs at the steps of the recursion (d length,)."""
    inputs, _, substeps, _, _ = excitation
    for i in range(inputs.shape[0]):
        if substeps > 1:
            interpolate(inputs[i], substeps, 0, steps[i * length : (i + 1) * length])
        else:
            for k in range(min(length, inputs.shape[1])):
                steps[i * length + k] = inputs[i, k]


@jit
def some_missing(observed):
    """Whether data (s, u) have gaps, or there are none."""
    missing = observed.shape[0] == 0
    for j in range(observed.shape[0]):
        for value in observed[j]:
            missing |= value != value
    return missing


@jit
def in_blocks(direct, length, share):
    """The inputs' own values (o d v) and v, where they lie if they fill all blocks, or else a copy."""
    orders, inputs, count = direct.shape
    if count >= length and count % share == 0:
        return direct.reshape(-1), count
    own = new_numbers(orders * inputs * length)
    for row in range(orders * inputs):
        for k in range(min(length, count)):
            own[row * length + k] = direct[row // inputs, row % inputs, k]
    return own, length


@jit
def new_samples(excitation, observed, n_times, n_sensors, widths):
    """`SampleArrays` and `Samples` of inputs (d, t), and of data (s, u), or none (0, 0) for a response."""
    inputs, stride = excitation.acceleration.shape[0], excitation.stride
    direct = np.ascontiguousarray(excitation.direct)  # reached by address
    share, sensors = lanes(widths.sample), even(n_sensors)
    size = BLOCK * share
    n_blocks = (n_times + size - 1) // size
    length = n_blocks * size
    step_length = length * stride
    steps, mask = new_numbers(inputs * step_length), new_numbers(sensors * size)
    copy_inputs(excitation, steps, step_length)
    ground, is_own, orders, own_length = steps, direct.size > 0, 1, length
    if stride > 1:
        ground = new_numbers(inputs * length)
        for i in range(inputs * length):
            ground[i] = steps[i * stride]
    own = ground
    if is_own:
        orders = direct.shape[0]
        own, own_length = in_blocks(direct, length, share)
    arrays, like = SampleArrays(steps, ground, own, new_numbers(sensors * size), mask), widths.sample
    return arrays, Samples(
        view(steps, 0.0),
        step_length,
        view(ground, like),
        length // share,
        view(own, like),
        is_own,
        own_length // share,
        view(mask, like),
        some_missing(observed),
        n_blocks,
        n_times,
        size,
        stride,
        inputs,
        orders,
    )


class BlockData(NamedTuple):
    """Data of a block: Rows of samples, float64 from one sensor to the next, and the last sensor.

    `is_masked` tells whether some are missing, which are zero then.
    """

    rows: object
    stride: int
    last: int
    is_masked: bool


@jit
def data_of(arrays, samples, observed, block):
    """`BlockData`: the data where they lie; where some are missing a copy, and the mask is written."""
    first, size, like = block * samples.size, samples.size, zero(samples.mask)
    last = max(observed.shape[0] - 1, 0)
    if not samples.has_gaps and first + size <= samples.n_times:
        return BlockData(moved(view(observed, like), first), samples.n_times, last, False)
    for j in range(observed.shape[0]):
        for k in range(size):
            is_there = first + k < samples.n_times and observed[j, first + k] == observed[j, first + k]
            arrays.mask[j * size + k] = 1.0 if is_there else 0.0
            arrays.data[j * size + k] = observed[j, first + k] if is_there else 0.0
    return BlockData(view(arrays.data, like), size, last, observed.shape[0] > 0)


@jit
def four_data(data, j, k):
    """Four rows of data of sensor j; a sensor that fills up a pair has those of the last."""
    return four(moved(data.rows, min(j, data.last) * data.stride), k)


@jit
def filled(count, widths):
    """The next number of modes that fills rows of the march."""
    share = lanes(widths.sample)
    return (count + share - 1) // share * share


@jit
def four(rows, first):
    """Four numbers of rows."""
    return new_four(rows[first], rows[first + 1], rows[first + 2], rows[first + 3])


@jit
def put_four(rows, first, x):
    """Write four numbers."""
    rows[first], rows[first + 1], rows[first + 2], rows[first + 3] = x.first, x.second, x.third, x.fourth


@jit
def gathered(rows, count, target, like):
    """Write sums over the samples in the lanes into the same memory; of many structures nothing changes."""
    for i in range(count):
        target[i] = the_narrowed(rows[i], like)
