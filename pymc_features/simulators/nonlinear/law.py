"""Restoring-force laws of springs, chosen when a kernel is compiled.

A law is a type of named tuple that says where the memory of a chain lies (`spring_chain.py`): its `address`,
the `rows` of vectors for its `n` springs; and five functions of it, registered by `register`. The kernels
call `spring`, `partials`, `pace`, `is_law` and `has_kinks`; Numba picks the functions from the *type* of the
tuple, so that each law has a kernel of its own, without a branch, and its machine code is kept on disk as
any other.

`spring`, `partials` and `pace` take and return vectors (`lanes.py`): `LANES` springs at a time, the group
number `row` of them. A law reads its parameters of these springs by `parameter`, of one spring by `single`.
"""

from collections.abc import Callable
from typing import NamedTuple

from numba.extending import overload

from pymc_features.simulators.compiled.jit import FASTMATH, jit
from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number

PARAMETERS = 8  # at most, of a law; they lie at the beginning of the memory

OPTIONS = {"fastmath": FASTMATH, "error_model": "numpy"}


class Functions(NamedTuple):
    """What makes a law: the number of its parameters, and the functions below."""

    n_parameters: int
    spring: Callable
    partials: Callable
    pace: Callable
    is_law: Callable
    has_kinks: Callable


LAWS: dict[type, Functions] = {}


def register(law: type, functions: Functions):
    """Make a law known to the kernels."""
    LAWS[law] = functions


@jit
def parameter(law, name, row):
    """The law's parameter number `name` of the springs of group `row`."""
    return read_lanes(law.address, name * law.rows + row)


@jit
def single(law, name, i):
    """The law's parameter number `name` of spring `i`."""
    return read_number(law.address, name * law.rows * LANES + i)


def spring(law, row, stiffness, drift, rate, memory, branch):
    """Forces of springs [N] and rates of their internal variables [1/s]; `drift` [m], `rate` [m/s].

    `branch` is 1 where drift rate and internal variable have one sign (loading), -1 where not. It is that of
    a whole step, which ends where it changes: on the way a trial may be a little beyond, and the law must be
    smooth there.
    """
    return LAWS[type(law)].spring(law, row, stiffness, drift, rate, memory, branch)


def partials(law, row, stiffness, drift, rate, memory, branch):
    """Partial derivatives of both results of `spring`.

    Returns two tuples, of the forces' derivatives and of the other rates', each by stiffness, drift, rate,
    memory and the law's parameters in their order.
    """
    return LAWS[type(law)].partials(law, row, stiffness, drift, rate, memory, branch)


def pace(law, row, stiffness, omega, drift, rate, change):
    """Rate [1/s] at which springs depart from linear ones: a step must be short beside its inverse.

    `omega` is the highest angular frequency of the linear chain [rad/s], `change` the second time
    derivative of the drift [m/s^2].
    """
    return LAWS[type(law)].pace(law, row, stiffness, omega, drift, rate, change)


def is_law(law, i):
    """Whether the parameters of spring `i` lie in their ranges; false for NaN."""
    return LAWS[type(law)].is_law(law, i)


def has_kinks(law):
    """Whether the law has kinks where the drift rate or the internal variable changes its sign."""
    return LAWS[type(law)].has_kinks(law)


@overload(spring, jit_options=OPTIONS)
def _spring(law, row, stiffness, drift, rate, memory, branch):
    return LAWS[law.instance_class].spring


@overload(partials, jit_options=OPTIONS)
def _partials(law, row, stiffness, drift, rate, memory, branch):
    return LAWS[law.instance_class].partials


@overload(pace, jit_options=OPTIONS)
def _pace(law, row, stiffness, omega, drift, rate, change):
    return LAWS[law.instance_class].pace


@overload(is_law, jit_options=OPTIONS)
def _is_law(law, i):
    return LAWS[law.instance_class].is_law


@overload(has_kinks, jit_options=OPTIONS)
def _has_kinks(law):
    return LAWS[law.instance_class].has_kinks
