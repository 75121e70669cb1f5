"""Responses of many linear structures at once, one block of time after another.

A statistic over structures needs the values of all of them at one time, not their histories: each structure
is kept as its recursion coefficients and modal states, and all are carried through a block of time together.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.recursion import BLOCK, advance
from pymc_features.simulators.request import Request

MEMORY = 16 * 2**20  # of a block of responses [bytes]


class Systems(NamedTuple):
    """Recursions of n structures with m modes under d inputs.

    Attributes
    ----------
    tables : array (n, 11, m)
        Recursion and output coefficients, see `recursion`.
    participation : array (n, d, m)
        Of the modes in the inputs.
    shapes : array (n, row, m)
        What each mode adds to the rows.
    direct : array (n, row, d)
        Feed-through of the inputs.
    """

    tables: np.ndarray
    participation: np.ndarray
    shapes: np.ndarray
    direct: np.ndarray


def block_size(n: int, n_rows: int) -> int:
    """Samples in a block of responses of `n` structures, which takes `MEMORY` at most, or one sample."""
    return int(np.clip(MEMORY // (8 * n * n_rows), 1, BLOCK))


def response_blocks(systems: Systems, inputs, asked: Request, size: int):
    """Yield (first sample, responses (row, time, structure)) of one block of time after another.

    The responses are in a buffer that the next block overwrites; whoever receives them may do so as well.
    A block has `size` samples, the last as many as are left; `inputs` (d, t).
    """
    n, n_rows, n_modes = systems.shapes.shape
    states = np.zeros((2, n, inputs.shape[0], n_modes))
    buffer = np.empty((n_rows, size, n))
    total = asked.n_outputs(inputs.shape[1])
    for first in range(0, total, size):
        count = min(size, total - first)
        advance_all(systems, states, inputs, (asked.substeps, asked.stride), first, count, buffer)
        yield first, buffer[:, :count]


@jit
def advance_all(systems, states, inputs, sampling, first, count, responses):
    """Carry structures through output samples `first` ... `first + count - 1`, as `advance` does with one.

    Parameters
    ----------
    systems : Systems
    states : array (2, n, d, m)
        Modal states q and p; overwritten.
    inputs : array (d, t)
    sampling : tuple of int
        `substeps` and `stride` of the request.
    responses : array (row, >= count, n)
        Written.
    """
    tables, participation, shapes, direct = systems
    q, p = states[0], states[1]
    substeps, stride = sampling
    n, n_rows, n_modes = shapes.shape
    size = responses.shape[1]
    modal = np.empty((size, n_modes))
    moved = np.empty((size, n_modes))
    ground = np.empty((inputs.shape[0], size))
    block = np.empty((n_rows, size))
    for i in range(n):
        moved[:] = 0.0
        for k in range(inputs.shape[0]):
            advance(tables[i], q[i, k], p[i, k], inputs[k], substeps, stride, first, count, modal, ground[k])
            for b in range(count):
                for r in range(n_modes):
                    moved[b, r] += participation[i, k, r] * modal[b, r]
        np.dot(shapes[i], moved.T, block)
        for k in range(1, inputs.shape[0]):
            for j in range(n_rows):
                for b in range(count):
                    block[j, b] += direct[i, j, k] * ground[k, b]
        for j in range(n_rows):
            for b in range(count):
                responses[j, b, i] = block[j, b] + direct[i, j, 0] * ground[0, b]
