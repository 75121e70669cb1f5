"""Elementary functions of vectors, for the laws of springs."""

from math import factorial

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import larger, where_less
from pymc_features.simulators.numbers.vectors import all_equal, exponent, nearest, scale, splat

TINY = 1e-300  # what a zero counts as in a logarithm
# Coefficients of log m / r = 2 sum r^(2k) / (2k + 1), r = (m - 1)/(m + 1), for m from sqrt(1/2) to sqrt(2),
# and of the exponential, for arguments below log(2)/2: the next terms are below 1e-18
LOGARITHM = tuple(2.0 / (2 * k + 1) for k in range(12))
EXPONENTIAL = tuple(1.0 / factorial(k) for k in range(14))


@jit
def polynomial(coefficients, x):
    """Polynomial with an even number of coefficients, in two halves side by side: half the waiting."""
    square = x * x
    last = len(coefficients) - 2
    even, odd = splat(coefficients[last]), splat(coefficients[last + 1])
    for k in range(last - 2, -1, -2):
        even = even * square + coefficients[k]
        odd = odd * square + coefficients[k + 1]
    return even + x * odd


@jit
def logarithm(x):
    """Natural logarithm of non-negative numbers, to 2e-16 of the larger of it and one; of zero, -691."""
    x = larger(x, splat(TINY))
    power_of_two = exponent(x)
    m = scale(x, 0.0 - power_of_two)
    ratio = (m - 1.0) / (m + 1.0)
    return power_of_two * np.log(2.0) + ratio * polynomial(LOGARITHM, ratio * ratio)


@jit
def exponential(x):
    """e^x to 1e-16 (1 + |x|) of it, with x held between -700 and 700."""
    x = larger(where_less(splat(700.0), x, splat(700.0), x), splat(-700.0))
    power_of_two = nearest(x * (1.0 / np.log(2.0)))
    return scale(polynomial(EXPONENTIAL, x - power_of_two * np.log(2.0)), power_of_two)


@jit
def power(size, order):
    """size^order for non-negative sizes and positive orders."""
    if all_equal(order, splat(2.0)):
        return size * size
    if all_equal(order, splat(1.0)):
        return size
    return where_less(splat(TINY), size, exponential(order * logarithm(size)), splat(0.0))
