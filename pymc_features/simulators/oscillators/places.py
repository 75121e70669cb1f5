"""Where the memory of `lanes`, the excitation and the data are: compiled code reaches them by address.

An array among the arguments of a function costs two atomic operations, see `compiled.vector_memory.aligned`;
a block of samples is over before a dozen arrays have been counted.
"""

from typing import NamedTuple

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector_memory import address
from pymc_features.simulators.oscillators.arguments import interpolate
from pymc_features.simulators.oscillators.lanes import SAMPLES, copy_data

NUMBER = 8  # bytes


class Places(NamedTuple):
    """Sizes of `Lanes`, and the addresses of its arrays.

    Attributes
    ----------
    m, n_sensors, width : int
        Modes, an even number, sensors, and columns of the shapes.
    is_pair : bool
    coefficients, states, shapes, feed, direct, outputs, misfits, squares : int
    """

    m: int
    n_sensors: int
    width: int
    is_pair: bool
    coefficients: int
    states: int
    shapes: int
    feed: int
    direct: int
    outputs: int
    misfits: int
    squares: int


class Source(NamedTuple):
    """Where excitation and data of the blocks are.

    Attributes
    ----------
    ground, n_ground, own_ground : int
        Address of the excitation, how many entries it has, and address of `Lanes.ground`.
    stride : int
    data, n_times, length, own_data : int
        Address of the data, samples of a sensor, from one sensor to the next, and address of `Lanes.data`.
    excess : int
        Address of `Lanes.excess`; zero where there is none.
    is_plain : bool
        Whether the samples of a sensor stand one after the other, and sensors whole numbers apart.
    """

    ground: int
    n_ground: int
    own_ground: int
    stride: int
    data: int
    n_times: int
    length: int
    own_data: int
    excess: int
    is_plain: bool


class Block(NamedTuple):
    """What all structures are subjected to, and compared with, in one block of samples.

    Attributes
    ----------
    ground, stride : int
        Address of the excitation at the first sample, and how many entries behind it the next one is.
    data, length : int
        Address of the first sample of the first sensor, and how many entries behind it the next one is.
    excess : int
        Address of the first value of `Lanes.excess`; zero where there is none.
    """

    ground: int
    stride: int
    data: int
    length: int
    excess: int


@jit
def places_of(lanes):
    """Where the arrays of `lanes` are."""
    m, width = lanes.states.shape[0] // 2, lanes.shapes.shape[0] // lanes.feed.shape[0]
    return Places(
        m,
        lanes.data.shape[0],
        width,
        width == 2 * m,
        address(lanes.coefficients),
        address(lanes.states),
        address(lanes.shapes),
        address(lanes.feed),
        address(lanes.direct),
        address(lanes.outputs),
        address(lanes.misfits),
        address(lanes.squares),
    )


@jit
def source_of(lanes, excitation, observed):
    """Where the excitation, as of `at_every_step`, and the data (s, u) are."""
    acceleration = excitation.acceleration
    return Source(
        address(acceleration),
        acceleration.size,
        address(lanes.ground),
        excitation.stride,
        address(observed),
        observed.shape[1],
        observed.strides[0] // NUMBER,
        address(lanes.data),
        address(lanes.excess) if lanes.excess.size else 0,
        observed.strides[1] == NUMBER and observed.strides[0] % NUMBER == 0,
    )


@jit
def has_own_ground(source, first):
    """Whether the excitation of the block from sample `first` on ends."""
    return (first + SAMPLES) * source.stride > source.n_ground


@jit
def has_own_data(source, first):
    """Whether the data of the block from sample `first` on end, or are strided."""
    return first + SAMPLES > source.n_times or not source.is_plain


@jit
def copy_block(lanes, source, excitation, observed, first):
    """Write what `block_of` reads in the lanes, excitation or data or both; zeros behind the end."""
    if has_own_ground(source, first):
        interpolate(excitation.acceleration, 1, first * excitation.stride, lanes.ground)
    if has_own_data(source, first):
        copy_data(lanes, observed, first)


@jit
def block_of(source, first):
    """The block from sample `first` on, which is in the lanes where it has to be."""
    ground, data = source.ground + NUMBER * first * source.stride, source.data + NUMBER * first
    is_own = has_own_data(source, first)
    return Block(
        source.own_ground if has_own_ground(source, first) else ground,
        source.stride,
        source.own_data if is_own else data,
        SAMPLES if is_own else source.length,
        source.excess + NUMBER * first if source.excess else 0,
    )
