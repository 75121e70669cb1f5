"""The march of oscillators through a record, and the misfit against data, for numbers of any kind and width.

    y[k+1] = e y[k] + c a[k],      r_j[k] = x_j[k] - f_j a[k] - sum_r S_jr Gamma_r output(y_r[k]),
    e_j = (1/N) sum_k r_j[k]^2

    x_j            data of sensor j
    S_jr, Gamma_r  shape of mode r at sensor j, participation
    f_j            what stands before the input, see `modal_lanes`

Between the march and the sensors the lanes of one structure's modes are turned into lanes of samples; all
else is the same line for many structures and for one, see `samples`.

Statistics of misfits, and responses, of structures in lanes.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import (
    abreast,
    lanes,
    new_four,
    new_quadratic,
    registers,
    the_narrowed,
    the_output,
    the_sum,
    the_value,
)
from pymc_features.simulators.numbers.rows import side_by_side, turn, view, zero
from pymc_features.simulators.oscillators.arguments import Excitation
from pymc_features.simulators.oscillators.modal_lanes import write_oscillators
from pymc_features.simulators.oscillators.samples import (
    BLOCK,
    data_of,
    even,
    filled,
    four,
    four_data,
    gathered,
    new_numbers,
    new_samples,
    put_four,
)

GROUP = 16  # modes whose outputs of a block stay in the first-level cache; even


class OscillatorArrays(NamedTuple):
    """Arrays behind `Oscillators`; the caller keeps them."""

    transition: np.ndarray
    drive: np.ndarray
    states: np.ndarray
    outputs: np.ndarray
    turned: np.ndarray
    following: np.ndarray
    shapes: np.ndarray
    feed: np.ndarray
    direct: np.ndarray
    misfits: np.ndarray
    squares: np.ndarray
    ends: np.ndarray


class Oscillators(NamedTuple):
    """Oscillators on their way through a record, as `Rows`.

    Attributes
    ----------
    transition, drive, states : states (rows), (rows), (d, rows)
        e, c and y of each row of modes.
    outputs, turned : outputs of states
        Of a block, see `advance`; with samples in the lanes, see `place_of`.
    following : outputs of states (orders, modes)
        What stands before the inputs' own values in modes that follow them.
    shapes : structure's numbers (s, d, modes)
        S Phi Gamma.
    feed, direct : structure's numbers (s, d)
        Before the input at the outputs, and before its own values.
    misfits, squares : wide (s, BLOCK), (s)
    ends : structure's numbers (3, s)
        Sums of squared increments, first and last misfit.
    modes, sensors, rows : int
        Even numbers, and rows of modes under one input.
    """

    transition: object
    drive: object
    states: object
    outputs: object
    turned: object
    following: object
    shapes: object
    feed: object
    direct: object
    misfits: object
    squares: object
    ends: object
    modes: int
    sensors: int
    rows: int


@jit
def new_oscillators(n_modes, n_sensors, together, state, samples, widths):
    """Arrays and `Oscillators` with states like the one given, of which outputs of `together` modes stay."""
    share, wide, one = lanes(widths.sample), lanes(widths.wide), lanes(widths.structure)
    m, s, d, output = even(n_modes), even(n_sensors), samples.inputs, the_output(state)
    rows, parts = even(filled(m, widths) // share), registers(output)
    size = rows * registers(state) * wide
    block = even(filled(together, widths) // share) * share * BLOCK * parts * wide
    outputs = new_numbers(block)
    arrays = OscillatorArrays(
        new_numbers(size),
        new_numbers(size),
        new_numbers(size * d),
        outputs,
        outputs if share == 1 else new_numbers(block),
        new_numbers(samples.orders * m * parts * one),
        new_numbers(s * d * m * one),
        new_numbers(s * d * one),
        new_numbers(s * d * one),
        new_numbers(s * BLOCK * wide),
        new_numbers(s * wide),
        new_numbers(3 * s * one),
    )
    like, across = widths.structure, widths.wide
    return arrays, Oscillators(
        view(arrays.transition, state),
        view(arrays.drive, state),
        view(arrays.states, state),
        view(arrays.outputs, output),
        view(arrays.turned, output),
        view(arrays.following, the_narrowed(output, widths.structure)),
        view(arrays.shapes, like),
        view(arrays.feed, like),
        view(arrays.direct, like),
        view(arrays.misfits, across),
        view(arrays.squares, across),
        view(arrays.ends, like),
        m,
        s,
        rows,
    )


@jit
def advance(modes, samples, block, i, first, count, base, share):
    """Take rows of modes under input i through a block; their outputs are written from `base` on.

    As many rows as go together go at once, so that one does not wait for the other.
    """
    transition, drive = side_by_side(modes.transition), side_by_side(modes.drive)
    states, outputs, together = side_by_side(modes.states), side_by_side(modes.outputs), abreast(modes.states)
    for n in range(count // together):
        r = first // together + n
        place, own = (base // together + n) * BLOCK * share, i * (modes.rows // together) + r
        ground = i * samples.step_length + block * BLOCK * share * samples.stride
        e, c, y = transition[r], drive[r], states[own]
        for _ in range(share):
            for k in range(BLOCK):
                outputs[place + k] = the_output(y)
                for _ in range(samples.stride):
                    y = e * y + c * samples.steps[ground]
                    ground += 1
            place += BLOCK
        states[own] = y


@jit
def turn_outputs(modes, count, base, share):
    """Write the outputs of rows of modes of one structure, modes `base` ..., with samples in the lanes."""
    step, samples = abreast(modes.outputs), BLOCK * share
    inner = 1 if step == 2 else BLOCK
    for g in range(count):
        source, place = (g // step * samples) * step + g % step, (base + g * share) * BLOCK
        for k in range(BLOCK):
            first, at = source + k * share * step, place + k * step
            turn(modes.outputs, first, step, modes.turned, at, 2 * BLOCK, inner)


@jit
def place_of(modes, r, k):
    """Place in `turned` of the output of mode r at row k of samples."""
    step = abreast(modes.turned)
    return (r // step * BLOCK + k) * step + r % step


@jit
def follow(modes, samples, block, i, first, count, base):
    """Add the outputs of modes that follow the inputs."""
    for r in range(count):
        for k in range(BLOCK):
            place = place_of(modes, base + r, k)
            y = modes.turned[place]
            for order in range(samples.orders):
                at = (order * samples.inputs + i) * samples.length + block * BLOCK + k
                y = y + modes.following[order * modes.modes + first + r] * samples.own[at]
            modes.turned[place] = y


@jit
def march_block(modes, samples, block, i, first, count, base, follows):
    """Take modes under input i through a block; outputs by modes `base` ... and rows of samples, in `turned`.

    `follows` tells whether some mode follows its input.
    """
    share = samples.size // BLOCK
    rows = (count + share - 1) // share
    rows += rows % abreast(modes.states)
    advance(modes, samples, block, i, first // share, rows, base if share == 1 else 0, share)
    if share > 1:
        turn_outputs(modes, rows, base, share)
    if follows:
        follow(modes, samples, block, i, first, count, base)


@jit
def four_outputs(modes, r, k):
    """Outputs of a mode at four rows of samples from k on."""
    step, outputs = abreast(modes.turned), modes.turned
    i = place_of(modes, r, k)
    return new_four(outputs[i], outputs[i + step], outputs[i + 2 * step], outputs[i + 3 * step])


@jit
def started(modes, samples, data, block, i, j, k):
    """Misfits of sensor j at four rows before its modes: data, or what is left of them, less feed-through."""
    at, own = block * BLOCK + k, j * samples.inputs + i
    ground = modes.feed[own] * four(samples.ground, i * samples.ground_length + at)
    if samples.is_own:
        ground = ground + modes.direct[own] * four(samples.own, i * samples.length + at)
    if i > 0:
        return four(modes.misfits, j * BLOCK + k) - ground
    return four_data(data, j, k) - ground


@jit
def compare(modes, samples, data, block, i, first, count, base):
    """Take what the sensors see of modes `first` ... in a block from the misfits, two sensors at a time.

    `base` is the first of these modes in `turned`.
    """
    is_last = first + count == modes.modes and i == samples.inputs - 1
    across = samples.inputs * modes.modes
    for j in range(0, modes.sensors, 2):
        row = j * across + i * modes.modes + first
        for k in range(0, BLOCK, 4):
            here, there = j * BLOCK + k, (j + 1) * BLOCK + k
            if first == 0:
                a = started(modes, samples, data, block, i, j, k)
                b = started(modes, samples, data, block, i, j + 1, k)
            else:
                a, b = four(modes.misfits, here), four(modes.misfits, there)
            for r in range(count):
                y = four_outputs(modes, base + r, k)
                a = a - modes.shapes[row + r] * the_value(y)
                b = b - modes.shapes[row + across + r] * the_value(y)
            if is_last:
                if data.is_masked:
                    a, b = a * four(samples.mask, here), b * four(samples.mask, there)
                modes.squares[j] = modes.squares[j] + the_sum(a * a)
                modes.squares[j + 1] = modes.squares[j + 1] + the_sum(b * b)
            put_four(modes.misfits, here, a)
            put_four(modes.misfits, there, b)


@jit
def add_increments(misfits, modes, samples, block, n_sensors):
    """Add the squared increments of the misfits (s, size) of a block; keep the first misfit and the last."""
    count = min(samples.size, samples.n_times - block * samples.size)
    for j in range(n_sensors):
        if block == 0:
            modes.ends[j], modes.ends[modes.sensors + j] = zero(modes.ends), misfits[j * samples.size]
            modes.ends[2 * modes.sensors + j] = misfits[j * samples.size]
        total, before = modes.ends[j], modes.ends[2 * modes.sensors + j]
        for k in range(count):
            step = misfits[j * samples.size + k] - before
            total, before = total + step * step, misfits[j * samples.size + k]
        modes.ends[j], modes.ends[2 * modes.sensors + j] = total, before


@jit
def march(modes, arrays, samples, sample_arrays, observed, follows, with_increments, history):
    """Take all modes through a record; sums of squares, see `gathered`, and increments are left in `modes`.

    The response (s, u) of the first structure is written into the history unless that is empty; `observed` is
    empty then.
    """
    # misfits as numbers of a structure, one sample after the other
    one = zero(modes.ends)
    misfits, count, lots = view(arrays.misfits, one), history.shape[0], lanes(one)
    for j in range(modes.sensors):
        modes.squares[j] = zero(modes.squares)
    for block in range(samples.n_blocks):
        data = data_of(sample_arrays, samples, observed, block)
        for i in range(samples.inputs):
            for first in range(0, modes.modes, GROUP):
                together = min(GROUP, modes.modes - first)
                march_block(modes, samples, block, i, first, together, 0, follows)
                compare(modes, samples, data, block, i, first, together, 0)
        if with_increments:
            add_increments(misfits, modes, samples, block, observed.shape[0])
        first = block * samples.size
        for j in range(count):
            for k in range(min(samples.size, samples.n_times - first)):
                history[j, first + k] = -arrays.misfits[(j * samples.size + k) * lots]


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
