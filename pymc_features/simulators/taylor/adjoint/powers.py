"""Bars of polynomials in place of |z|^n (`taylor/powers.py`), at a given range.

The coefficients c_k = c^(n - k) q_k(n) depend on the range as well. As the polynomial is |z|^n to its error
whatever the range, that is left out: P' by |z| is all that z has to do with it.
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import splat, where_less
from pymc_features.simulators.compiled.vector_math import exponential, logarithm
from pymc_features.simulators.taylor.adjoint.series import add_constant
from pymc_features.simulators.taylor.powers import (
    ACROSS,
    COEFFICIENTS,
    DEGREE,
    EXPONENT,
    HALF,
    MIDDLE,
    OUTSIDE,
    SQUARE,
    economise,
)
from pymc_features.simulators.taylor.series import constant_of


@jit
def economised_slopes(n, square):
    """Derivatives by n of the coefficients of `powers.economised`."""
    b2, d2 = n * (n - 1.0) * 0.5, n - 0.5
    b3, d3 = b2 * (n - 2.0) * (1.0 / 3.0), (d2 * (n - 2.0) + b2) * (1.0 / 3.0)
    b4, d4 = b3 * (n - 3.0) * 0.25, (d3 * (n - 3.0) + b3) * 0.25
    b5, d5 = b4 * (n - 4.0) * 0.2, (d4 * (n - 4.0) + b4) * 0.2
    b6, d6 = b5 * (n - 5.0) * (1.0 / 6.0), (d5 * (n - 5.0) + b5) * (1.0 / 6.0)
    d7 = (d6 * (n - 6.0) + b6) * (1.0 / 7.0)
    return economise((splat(1.0), d2, d3, d4, d5, d6, d7), square)


@jit
def add_power(spring, bars, first, factor, of, shape):
    """Add to the bars of n, and of the coefficients of a polynomial from or across zero, where one serves.

    The bars of the coefficients are `factor` times `of`; `shape` is the first constant of such a polynomial.
    """
    zero, n = splat(0.0), constant_of(spring, first + EXPONENT)
    middle, square = constant_of(spring, first + MIDDLE), constant_of(spring, first + SQUARE)
    extent = where_less(zero, middle, middle, constant_of(spring, first + HALF) * (1.0 / OUTSIDE))
    log, inverse = logarithm(extent), 1.0 / extent
    power = factor * exponential(n * log)
    near = where_less(square, zero, splat(1.0), zero)
    total, slopes = zero, economised_slopes(n, square)
    for k in range(DEGREE + 1):
        bar = power * of[k]
        total = total + (1.0 - near) * (bar * slopes[k])
        total = total + log * (factor * (of[k] * constant_of(spring, first + COEFFICIENTS + k)))
        if k < (3 if shape == ACROSS else DEGREE + 1):
            add_constant(bars, first + shape + k, near * bar)
        power = power * inverse
    add_constant(bars, first + EXPONENT, total)
