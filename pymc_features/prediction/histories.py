"""Responses of many linear structures at once, one block of time after another.

A statistic over structures needs the values of all of them at one time, not their histories: each structure
is kept as its recursion coefficients and modal states, and all are carried through a block of time together.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import (
    Excitation,
    interpolate,
    n_outputs,
    write_own,
)
from pymc_features.simulators.oscillators.table import advance, new_outputs

BLOCK = 128  # samples handled at a time: the working set stays in the first-level cache
MEMORY = 16 * 2**20  # of a block of responses [bytes]


class Recursions(NamedTuple):
    """Recursions of n structures with m modes under d inputs.

    Attributes
    ----------
    tables : array (n, d, 11, >= m)
        Recursion and output coefficients of each input, as `table.advance` takes them.
    shapes : array (n, row, m)
        Mode shapes at the rows.
    direct : array (n, row, d)
        Feed-through of the inputs.
    """

    tables: np.ndarray
    shapes: np.ndarray
    direct: np.ndarray


def block_size(n: int, n_rows: int) -> int:
    """Samples in a block of responses of `n` structures, which takes `MEMORY` at most, or one sample."""
    return int(np.clip(MEMORY // (8 * n * n_rows), 1, BLOCK))


def response_blocks(recursions: Recursions, excitation: Excitation, size: int):
    """Yield (first sample, responses (row, time, structure)) of one block of time after another.

    The responses are in a buffer that the next block overwrites; whoever receives them may do so as well.
    A block has `size` samples, the last as many as are left; the excitation has inputs (d, t).
    """
    n, n_rows, _ = recursions.shapes.shape
    states = np.zeros((*recursions.tables.shape[:2], 2, recursions.tables.shape[3]))
    buffer = np.empty((n_rows, size, n))
    total = n_outputs(excitation.acceleration.shape[1], excitation.substeps, excitation.stride)
    for first in range(0, total, size):
        count = min(size, total - first)
        advance_all(recursions, excitation, states, first, count, buffer)
        yield first, buffer[:, :count]


@jit
def advance_all(recursions, excitation, states, first, count, responses):
    """Carry structures through output samples `first` ... `first + count - 1`, as `advance` does with one.

    Parameters
    ----------
    recursions : Recursions
    excitation : Excitation
    states : array (n, d, 2, >= m)
        Modal displacements and velocities, scaled as in `advance`; overwritten.
    responses : array (row, >= count, n)
        Written.
    """
    tables, shapes, direct = recursions
    inputs, _, substeps, stride, _ = excitation
    n, n_rows, n_modes = shapes.shape
    size = responses.shape[1]
    modal, block = new_outputs(size, n_modes), np.empty((n_rows, size))
    ground = np.empty((inputs.shape[0], size * stride + 1))
    for k in range(inputs.shape[0]):
        interpolate(inputs[k], substeps, first * stride, ground[k])
    own = np.empty((inputs.shape[0], count))
    write_own(excitation, ground, first, count, own)
    for i in range(n):
        for k in range(inputs.shape[0]):
            advance(tables[i, k], k == 0, states[i, k], ground[k], stride, count, modal)
        np.dot(shapes[i], modal.T, block)
        add_feed(direct[i], own, count, block)
        for j in range(n_rows):
            for b in range(count):
                responses[j, b, i] = block[j, b]


@jit
def add_feed(feed, own, count, block):
    """Add what inputs (d, >= count) do directly to `count` samples of a block (s, >= count)."""
    for i in range(own.shape[0]):
        for j in range(block.shape[0]):
            share = feed[j, i]
            if share != 0.0:
                for b in range(count):
                    block[j, b] += share * own[i, b]
