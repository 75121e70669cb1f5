"""Restoring-force laws of springs, chosen when a kernel is compiled.

A law is a named tuple with one field `values` (rows, n), its parameters spring by spring, and four
functions of its values, registered by `register`. The kernels call `spring`, `pace`, `is_law` and
`has_kinks`; Numba picks the functions from the *type* of the tuple, so that each law has a kernel of its
own, without a branch, and its machine code is kept on disk as any other.
"""

from collections.abc import Callable
from typing import NamedTuple

from numba.extending import overload

from pymc_features.simulators.compilation import FASTMATH

OPTIONS = {"fastmath": FASTMATH, "error_model": "numpy"}


class Functions(NamedTuple):
    """What makes a law; see `spring`, `pace`, `is_law` and `has_kinks` for their arguments."""

    spring: Callable
    pace: Callable
    is_law: Callable
    has_kinks: Callable


LAWS: dict[type, Functions] = {}


def register(law: type, functions: Functions):
    """Make a law known to the kernels."""
    LAWS[law] = functions


def spring(law, i, stiffness, drift, rate, memory):
    """Force of spring `i` [N] and rate of its internal variable [1/s]; `drift` [m], `rate` [m/s]."""
    return LAWS[type(law)].spring(law, i, stiffness, drift, rate, memory)


def pace(law, i, stiffness, omega, drift, rate, change):
    """Rate [1/s] at which spring `i` departs from a linear one: a step must be short beside its inverse.

    `omega` is the highest angular frequency of the linear chain [rad/s], `change` the second time
    derivative of the drift [m/s^2].
    """
    return LAWS[type(law)].pace(law, i, stiffness, omega, drift, rate, change)


def is_law(law, i):
    """Whether the parameters of spring `i` lie in their ranges; false for NaN."""
    return LAWS[type(law)].is_law(law, i)


def has_kinks(law):
    """Whether the law has kinks where the drift rate or the internal variable changes its sign."""
    return LAWS[type(law)].has_kinks(law)


@overload(spring, jit_options=OPTIONS)
def _spring(law, i, stiffness, drift, rate, memory):
    return LAWS[law.instance_class].spring


@overload(pace, jit_options=OPTIONS)
def _pace(law, i, stiffness, omega, drift, rate, change):
    return LAWS[law.instance_class].pace


@overload(is_law, jit_options=OPTIONS)
def _is_law(law, i):
    return LAWS[law.instance_class].is_law


@overload(has_kinks, jit_options=OPTIONS)
def _has_kinks(law):
    return LAWS[law.instance_class].has_kinks
