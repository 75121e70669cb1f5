"""Responses of many structures at once, one block of time after another.

A statistic over structures needs the values of all of them at one time, not their histories: each structure
is kept as its recursion coefficients and modal states, and all are carried through a block of time together.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compilation import jit
from pymc_features.simulators.recursion import BLOCK, QUANTITIES, advance, modal_system
from pymc_features.simulators.sampling import UNITS, Request

MEMORY = 16 * 2**20  # of a block of responses [bytes]


class Response(NamedTuple):
    """What a response is made of: a quantity of the recursion, the dimension of its rows, its unit."""

    source: str
    dim: str | None
    units: str


# The quantities of the recursion, and those that are linear combinations of its rows
HISTORIES = {name: Response(name, "sensor", UNITS[name]) for name in QUANTITIES} | {
    "inter_storey_drift": Response("relative_displacement", "storey", "m"),
    "base_shear": Response("absolute_acceleration", None, "N"),
}


class Systems(NamedTuple):
    """Recursions of structures: tables (n, 11, m), shapes (n, row, m) and direct (n, row)."""

    tables: np.ndarray
    shapes: np.ndarray
    direct: np.ndarray


def has_response(parameters, step: float, n_modes: int) -> np.ndarray:
    """Whether each structure has a response, (n,); `parameters` and `step` as in `modal_systems`."""
    first = np.zeros(1, dtype=np.int64)
    return np.array(
        [modal_system(*own, step, first, n_modes, 0)[0] for own in zip(*parameters, strict=True)], dtype=bool
    )


def modal_systems(parameters, step: float, asked: Request, name: str) -> Systems:
    """Recursions of structures for one of `HISTORIES`.

    Parameters
    ----------
    parameters : tuple of arrays (n, ...)
        mass, stiffness, Rayleigh pair and damping ratios of structures that have a response.
    step : float
        Of the recursion [s].
    asked : Request
        Its sensors stand for storeys where the response is a drift.
    """
    source, dim, _ = HISTORIES[name]
    code, n_dof = QUANTITIES.index(source), parameters[0].shape[1]
    sensors = asked.sensors if dim == "sensor" else np.arange(n_dof)
    rows = []
    for own in zip(*parameters, strict=True):
        _, table, shapes, direct = modal_system(*own, step, sensors, asked.n_modes, code)
        if dim == "storey":  # x_i - x_{i-1}, the first against the base
            shapes, direct = (np.diff(v, axis=0, prepend=0.0)[asked.sensors] for v in (shapes, direct))
        elif dim is None:
            shapes, direct = ((own[0] @ v)[None] for v in (shapes, direct))
        rows.append((table, shapes, direct))
    return Systems(*(np.ascontiguousarray(np.stack(part)) for part in zip(*rows, strict=True)))


def response_blocks(systems: Systems, record, asked: Request):
    """Yield (first sample, responses (row, time, structure)) of one block of time after another.

    The responses are in a buffer that the next block overwrites; whoever receives them may do so as well.
    A block takes `MEMORY` at most, or one sample.
    """
    n, n_rows, n_modes = systems.shapes.shape
    size = int(np.clip(MEMORY // (8 * n * n_rows), 1, BLOCK))
    states = np.zeros((2, n, n_modes))
    buffer = np.empty((n_rows, size, n))
    total = asked.n_outputs(record.n_times)
    for first in range(0, total, size):
        count = min(size, total - first)
        advance_all(
            *systems,
            *states,
            record.acceleration,
            asked.substeps,
            asked.stride,
            first,
            count,
            buffer,
        )
        yield first, buffer[:, :count]


@jit
def advance_all(tables, shapes, direct, q, p, acceleration, substeps, stride, first, count, responses):
    """Carry structures through output samples `first` ... `first + count - 1`, as `advance` does with one.

    Parameters
    ----------
    tables, shapes, direct : array (n, 11, m), (n, row, m), (n, row)
        From `modal_systems`.
    q, p : array (n, m)
        Modal states; overwritten.
    responses : array (row, >= count, n)
        Written.
    """
    n, n_rows, n_modes = shapes.shape
    modal = np.empty((responses.shape[1], n_modes))
    ground = np.empty(responses.shape[1])
    block = np.empty((n_rows, responses.shape[1]))
    for i in range(n):
        advance(tables[i], q[i], p[i], acceleration, substeps, stride, first, count, modal, ground)
        np.dot(shapes[i], modal.T, block)
        for j in range(n_rows):
            for b in range(count):
                responses[j, b, i] = block[j, b] + direct[i, j] * ground[b]
