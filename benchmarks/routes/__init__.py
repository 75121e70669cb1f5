"""Routes from parameters to e_j: one route, one file.

Each has a function `prepare(case)` that returns a call without arguments, which returns e_j, shape (P, s).
The slow routes have no economy of scale, so a few particles tell their cost for each.
"""

from collections.abc import Callable
from typing import NamedTuple

from benchmarks.routes import (
    batched,
    filters,
    filters_plain,
    jax_scan,
    loop_over_time,
    scalar,
    state_space,
)


class Route(NamedTuple):
    """How to get e_j, and on how many particles of the batch to time it."""

    prepare: Callable
    particles: int


ROUTES = {
    "our batched kernel": Route(batched.prepare, 500),
    "the same, with increments for correlated errors": Route(batched.prepare_with_increments, 500),
    "our kernel, one particle at a time": Route(scalar.prepare, 500),
    "JAX, scan over time, vmap over particles": Route(jax_scan.prepare, 500),
    "NumPy, loop over time, arrays of particles": Route(loop_over_time.prepare, 500),
    "SciPy eigh + lfilter, coefficients by hand": Route(filters.prepare, 20),
    "SciPy eigh + lfilter, plain": Route(filters_plain.prepare, 20),
    "SciPy lsim, state space": Route(state_space.prepare, 2),
}
