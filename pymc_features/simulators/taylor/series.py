"""Taylor series of the springs of a chain, one chain in each lane: what a law writes its recurrence with.

Over a step of length H, in units of which time counts, every quantity is a polynomial, x(t) = sum_k x_k t^k.
The series of one spring lie one after the other in the memory of its record, `length` vectors each. From the
coefficients k of drift and drift rate, H d', and from those before, a law gives coefficient k of its force
and k + 1 of its internal variable:

    (x y)_k = sum_j x_j y_{k-j},    (x')_k = (k + 1) x_{k+1}.

A law has one recurrence or several, each for some values of its parameters; what none of them serves is
integrated by Runge-Kutta steps. In laws with kinks the first two series are the drift rate and z.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.vectors import load, splat, store

RATE, Z = range(2)  # series of laws with kinks
LONG = 2.0  # in steps: longer than any


class Group(NamedTuple):
    """Chains, one in each lane: addresses of their records, of what they come back to, and of modal damping.

    `modal` is 0 without it; otherwise there lie H M^-1 C, (n, n) vectors. `n` is the number of springs.
    """

    address: int
    kept: int
    modal: int
    n: int


class Spring(NamedTuple):
    """Addresses of the series of a spring, and of its constants behind them, in vectors."""

    address: int
    first: int
    length: int
    constants: int


class Pieces(NamedTuple):
    """Constants of springs whose series may be good for a part of a step only: see `ranges.py`.

    The time to the end of the step; 1 in a march and 0 in a batch of kinks; until when the series is good, 0
    where it is not; the middle of the range of |z|, how far from it |z| may be at the end, and the sign of z.
    """

    left: int
    whole: int
    hold: int
    middle: int
    half: int
    sign: int


class Series(NamedTuple):
    """A recurrence of a law.

    Attributes
    ----------
    order : int
        Of the polynomials.
    tolerance : float
        Largest |V_P| / (H^2 A), see `march.py`.
    n_series, n_constants : int
        Series and constants of each spring.
    serves : callable
        Parameters (rows, ...) -> bool (...): whether it serves such springs.
    constants : callable
        Stiffness (...) and parameters (rows, ...) -> list of the first constants, (...) each.
    expand : callable
        (spring, k, drift, rate) -> coefficient k of the force; writes coefficient k + 1 of z. `k` is a
        number when it is compiled.
    branch : callable, optional
        (spring, loading, sign) for laws with kinks: write the constants of the branch; `loading` is positive
        where drift rate and z have one sign, `sign` is that of z.
    tangent : callable, optional
        (spring, z) -> df/dd and dz/dd of the branch, and df/dz at a given drift.
    pieces : Pieces, optional
        Where the series of z may have to be put together of several in one step.
    adjoint : Adjoint, optional
        Of `adjoint/series.py`; without one gradients are by Runge-Kutta steps.
    """

    order: int
    tolerance: float
    n_series: int
    n_constants: int
    serves: Callable
    constants: Callable
    expand: Callable
    branch: Callable | None = None
    tangent: Callable | None = None
    pieces: Pieces | None = None
    adjoint: Any = None


@jit
def coefficient(spring, series, k):
    """Coefficient k of a series."""
    return load(spring.address, spring.first + series * spring.length + k)


@jit
def write_coefficient(spring, series, k, value):
    """Write coefficient k of a series."""
    store(spring.address, spring.first + series * spring.length + k, value)


@jit
def constant_of(spring, name):
    """Constant number `name` of the spring."""
    return load(spring.address, spring.constants + name)


@jit
def write_constant(spring, name, value):
    """Write constant number `name` of the spring."""
    store(spring.address, spring.constants + name, value)


@jit
def product(spring, a, b, k):
    """Coefficient k of the product of two series; what the newest coefficients are needed for comes last."""
    total = splat(0.0)
    for j in range(1, k):
        total = total + coefficient(spring, a, j) * coefficient(spring, b, k - j)
    if k > 0:
        total = total + coefficient(spring, a, k) * coefficient(spring, b, 0)
    return total + coefficient(spring, a, 0) * coefficient(spring, b, k)


@jit
def square(spring, a, k):
    """Coefficient k of the square of a series; what the newest coefficient is needed for comes last."""
    total, first = splat(0.0), coefficient(spring, a, 0)
    if k == 0:
        return first * first
    for j in range(1, (k + 1) // 2):
        total = total + coefficient(spring, a, j) * coefficient(spring, a, k - j)
    total = total + total
    if k % 2 == 0:
        middle = coefficient(spring, a, k // 2)
        total = total + middle * middle
    return total + (first + first) * coefficient(spring, a, k)
