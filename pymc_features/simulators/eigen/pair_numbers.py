"""Numbers a + b i with i^2 = -1, or +1 where both poles of a pair of modes are real, one in each lane."""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import splat


@jit
def times(x, y, square):
    """Product of two numbers (real, imaginary), i^2 = `square`."""
    return x[0] * y[0] + square * (x[1] * y[1]), x[0] * y[1] + x[1] * y[0]


@jit
def over(x, y, square):
    """Quotient of two such numbers."""
    size = splat(1.0) / (y[0] * y[0] - square * (y[1] * y[1]))
    real, imaginary = times(x, (y[0], 0.0 - y[1]), square)
    return real * size, imaginary * size


@jit
def impedance(pole, square, omega, d):
    """lambda^2 + d lambda + omega^2."""
    own = times(pole, pole, square)
    return own[0] + omega * omega + d * pole[0], own[1] + d * pole[1]
