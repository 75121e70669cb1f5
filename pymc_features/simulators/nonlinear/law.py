"""Restoring-force laws of springs, chosen when a kernel is compiled.

A law is a type of named tuple that says where the memory of a chain lies (`layout.py`): its `address`, the
`rows` of vectors for its `n` springs. Four functions of it are registered by `register`. The kernels call
`spring`, `step_rate`, `is_admissible` and `has_kinks`; Numba picks the functions by the *type* of the tuple,
so that each law has a kernel of its own, without a branch, and its machine code is kept on disk as any other.

`spring` and `step_rate` take and return vectors (`vector.py`): `LANES` springs at a time, the group number
`row` of them. A law reads its parameters of these springs by `parameter`, of one spring by
`single`. Both results of `spring` depend on

    stiffness   initial stiffness k [N/m]
    drift       d, the displacement between the ends of a spring [m]
    rate        d', its time derivative [m/s]
    z           internal variable of the spring, 0 where a law has none
    branch      1 while the drift rate and z have one sign (loading), -1 while not (unloading)

The branch is that of a whole step, which ends where it changes: a trial may lie a little beyond that point,
and the law must be smooth there.
"""

from collections.abc import Callable
from typing import NamedTuple

from numba.extending import overload

from pymc_features.simulators.compiled.jit import FASTMATH, jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number
from pymc_features.simulators.taylor.series import Series

MAX_PARAMETERS = 8  # of a law; they lie at the beginning of the memory

OPTIONS = {"fastmath": FASTMATH, "error_model": "numpy"}


class Functions(NamedTuple):
    """What makes a law: the number of its parameters, the functions below, and its Taylor recurrences."""

    n_parameters: int
    spring: Callable
    step_rate: Callable
    is_admissible: Callable
    has_kinks: Callable
    series: dict[type, Series] = {}  # noqa: RUF012


LAWS: dict[type, Functions] = {}
SERIES: dict[type, Series] = {}  # by the types of the groups that they march


def register(law: type, functions: Functions):
    """Make a law known to the kernels."""
    LAWS[law] = functions
    SERIES.update(functions.series)


@jit
def parameter(law, name, row):
    """The law's parameter number `name` of the springs of group `row`."""
    return read_lanes(law.address, name * law.rows + row)


@jit
def single(law, name, i):
    """The law's parameter number `name` of spring `i`."""
    return read_number(law.address, name * law.rows * LANES + i)


def spring(law, row, stiffness, drift, rate, z, branch):
    """Forces f of springs [N], and time derivatives z' of their internal variables."""
    return LAWS[type(law)].spring(law, row, stiffness, drift, rate, z, branch)


def step_rate(law, row, stiffness, omega, drift, rate, acceleration):
    """Rate [1/s] at which springs depart from linear ones; steps must be short beside its inverse.

    `omega` is the largest rate of change of the linear chain [rad/s], `acceleration` d" [m/s^2].
    """
    return LAWS[type(law)].step_rate(law, row, stiffness, omega, drift, rate, acceleration)


def is_admissible(law, i):
    """Whether the parameters of spring `i` lie in their ranges; false for NaN."""
    return LAWS[type(law)].is_admissible(law, i)


def has_kinks(law):
    """Whether the law has kinks where the drift rate or the internal variable changes its sign."""
    return LAWS[type(law)].has_kinks(law)


@overload(spring, jit_options=OPTIONS)
def _spring(law, row, stiffness, drift, rate, z, branch):
    return LAWS[law.instance_class].spring


@overload(step_rate, jit_options=OPTIONS)
def _step_rate(law, row, stiffness, omega, drift, rate, acceleration):
    return LAWS[law.instance_class].step_rate


@overload(is_admissible, jit_options=OPTIONS)
def _is_admissible(law, i):
    return LAWS[law.instance_class].is_admissible


@overload(has_kinks, jit_options=OPTIONS)
def _has_kinks(law):
    return LAWS[law.instance_class].has_kinks
