"""Restoring-force laws of springs, chosen when a kernel is compiled.

A law is a type of named tuple that says where the memory of a chain lies (`layout.py`): its `address`, the
`rows` of vectors for its `n` springs. Four functions of it are registered by `register`. The kernels call
`spring`, `step_rate`, `is_admissible` and `has_kinks`; Numba picks the functions by the *type* of the tuple,
so that each law has a kernel of its own, without a branch, and its machine code is kept on disk as any other.

`spring` and `step_rate` take and return vectors (`numbers.vectors`), `LANES` springs at a time: group number
`row` of them. A law reads its parameters of these springs by `parameter`, of one spring by
`single`. Both results of `spring` depend on

    stiffness   initial stiffness k [N/m]
    drift       d, the displacement between the ends of a spring [m]
    rate        d', its time derivative [m/s]
    z           internal variable of the spring, 0 where a law has none
    branch      1 while the drift rate and z have one sign (loading), -1 while not (unloading)

The branch is that of a whole step, which ends where it changes: a trial may lie a little beyond that point,
and the law must be smooth there.

Layout of the memory in which a nonlinear chain is integrated.

A chain works in one piece of memory, which compiled code reaches by its address (`vectors.aligned`
says why). It is divided into blocks of p numbers, p the number of springs n rounded up to full vectors; entry
i of a block belongs to spring i or to the degree of freedom above it.

==================  =======================================  ==========
Block               Memory of the chain                      Unit
==================  =======================================  ==========
0 ... 7             parameters of the law, one block each    the law's
`ACTIVE`            1, or 0 in the padding beyond n          -
`INVERSE_MASS`      1/m_i                                    1/kg
`STIFFNESS`         k_i                                      N/m
`DASHPOT`           beta k_i, stiffness-proportional         N s/m
`MASS_DAMPING`      alpha, mass-proportional                 1/s
`SCALARS`           three numbers, named below               -
`CROSSINGS` (2)     how often each of 2n kinks was passed    -
`BRANCH`            1 where springs are loaded, -1 where     -
                    they are unloaded
`STATES` + 3 s      state at stage s: u, v and z, a block    m, m/s, -
                    each
`SLOPES` + 3 s      its time derivative: u', v' and z'
`MODAL_DAMPING`     columns of M^-1 C of modal ratios (n)    1/s
==================  =======================================  ==========

Stage 0 is the start of a step and holds the present state between steps; stages 1 to 5 lie within the step,
and stage `LAST` = 6 is its end.

The parameters of a chain of nonlinear springs.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from pymc_features.simulators.compiled.jit import FASTMATH, jit
from pymc_features.simulators.numbers.vectors import LANES, aligned, load, read_number, write_number
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
    return load(law.address, name * law.rows + row)


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


N_STAGES = 7
LAST = N_STAGES - 1

ACTIVE, INVERSE_MASS, STIFFNESS, DASHPOT, MASS_DAMPING, SCALARS, CROSSINGS = range(
    MAX_PARAMETERS, MAX_PARAMETERS + 7
)
BRANCH = CROSSINGS + 2
STATES = BRANCH + 1
SLOPES = STATES + 3 * N_STAGES
MODAL_DAMPING = SLOPES + 3 * N_STAGES
# Scalars: largest rate of change of the linear chain [1/s]; 1 if there is damping by modal ratios, else 0;
# number of parts into which every step is divided
LINEAR_RATE, HAS_MODAL_DAMPING, REFINE = range(3)


def padded(n: int) -> int:
    """The number n rounded up to full vectors."""
    return LANES * -(-n // LANES)


def chain_memory(n: int) -> np.ndarray:
    """Memory of a chain of n degrees of freedom; zero."""
    return aligned((MODAL_DAMPING + n) * padded(n))


@jit
def state(law, s):
    """First vector of the state of stage `s`."""
    return (STATES + 3 * s) * law.rows


@jit
def slope(law, s):
    """First vector of the slope of stage `s`."""
    return (SLOPES + 3 * s) * law.rows


@jit
def constant(law, block, row):
    """Group `row` of a block of the chain's memory."""
    return load(law.address, block * law.rows + row)


@jit
def scalar(law, name):
    """One of the scalars of the chain."""
    return read_number(law.address, SCALARS * law.rows * LANES + name)


@jit
def put(law, block, i, value):
    """Write entry `i` of a block of the chain's memory."""
    write_number(law.address, block * law.rows * LANES + i, value)


class NonlinearParameters(NamedTuple):
    """Masses on nonlinear springs in a row; of a population each array has one more axis in front.

    Attributes
    ----------
    mass, stiffness, rayleigh, ratios : array (n,), (n,), (2,), (n,)
        As of `ChainParameters`, with the springs' initial stiffnesses.
    law : array (rows, n)
        Parameters of the law of each spring.
    """

    mass: np.ndarray
    stiffness: np.ndarray
    rayleigh: np.ndarray
    ratios: np.ndarray
    law: np.ndarray


@jit
def particle(parameters, k):
    """Parameters of particle `k` of a population, each with a row for it or one for all."""
    mass, stiffness, rayleigh, ratios, values = parameters
    return NonlinearParameters(
        mass[k % mass.shape[0]],
        stiffness[k % stiffness.shape[0]],
        rayleigh[k % rayleigh.shape[0]],
        ratios[k % ratios.shape[0]],
        values[k % values.shape[0]],
    )


def n_particles(parameters) -> int:
    """Number of particles of a population."""
    sizes = {len(p) for p in parameters}
    if len(sizes - {1}) > 1:
        raise ValueError(
            f"all parameters must have one row, or one for each particle, got {sorted(sizes)} rows."
        )
    return max(sizes)


def check_parameters(law, parameters, wanted):
    """Refuse parameters and outputs whose sizes would make a kernel read outside its arrays."""
    n, sensors = parameters.mass.shape[-1], wanted.sensors
    expected = NonlinearParameters((n,), (n,), (2,), (n,), (LAWS[law].n_parameters, n))
    for name, values, shape in zip(parameters._fields, parameters, expected, strict=True):
        if values.shape[-len(shape) :] != shape:
            raise ValueError(f"`{name}` must have the shape {shape} of {n} springs, got {values.shape}.")
    if wanted.n_modes != n:
        raise ValueError(f"`n_modes` must be all {n} of a nonlinear chain, got {wanted.n_modes}.")
    if sensors.size and (sensors.min() < 0 or sensors.max() >= n):
        raise ValueError(f"`sensors` must be degrees of freedom from 0 to {n - 1}, got {sensors.tolist()}.")


def check_history(history, expected) -> np.ndarray:
    """Return data or a cotangent of the response, if it has its shape."""
    if history.shape != expected:
        raise ValueError(
            "`observed`, or the cotangent, must have the shape (sensor, time) of the response, "
            f"{expected}, got {history.shape}."
        )
    return history
