"""Elementary functions of vectors (`lanes.py`), for the laws of springs."""

import numpy as np

from pymc_features.simulators.compilation import jit
from pymc_features.simulators.lane_bits import all_equal, exponent, scale
from pymc_features.simulators.lanes import nearest, splat, where_less

TINY = 1e-300  # what a zero counts as in a logarithm
# Terms of log m = 2 atanh((m - 1)/(m + 1)), m from sqrt(1/2) to sqrt(2): the next is below 1e-18
LOG_TERMS = 11
EXP_TERMS = 14  # of the exponential series: with |x| below log(2)/2 the next is below 1e-18


@jit
def larger(a, b):
    """The larger of two numbers, lane by lane."""
    return where_less(a, b, b, a)


@jit
def logarithm(x):
    """Natural logarithm of non-negative numbers, to 2e-16 of the larger of it and one; of zero, -691."""
    x = larger(x, splat(TINY))
    power_of_two = exponent(x)
    m = scale(x, 0.0 - power_of_two)
    ratio = (m - 1.0) / (m + 1.0)
    square = ratio * ratio
    series = splat(1.0 / (2 * LOG_TERMS - 1))
    for k in range(LOG_TERMS - 2, -1, -1):
        series = series * square + 1.0 / (2 * k + 1)
    return power_of_two * np.log(2.0) + 2.0 * ratio * series


@jit
def exponential(x):
    """e^x to 1e-16 (1 + |x|) of it, with x held between -700 and 700."""
    x = larger(where_less(splat(700.0), x, splat(700.0), x), splat(-700.0))
    power_of_two = nearest(x * (1.0 / np.log(2.0)))
    rest = x - power_of_two * np.log(2.0)
    series = splat(1.0)
    for k in range(EXP_TERMS - 1, 0, -1):
        series = 1.0 + rest * series * (1.0 / k)
    return scale(series, power_of_two)


@jit
def power(size, order):
    """size^order for non-negative sizes and positive orders."""
    if all_equal(order, splat(2.0)):
        return size * size
    if all_equal(order, splat(1.0)):
        return size
    return where_less(splat(TINY), size, exponential(order * logarithm(size)), splat(0.0))
