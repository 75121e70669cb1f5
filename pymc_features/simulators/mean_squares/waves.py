"""Functions of the poles in the lanes: exp(lambda h), the first-order hold, weights of the stencil."""

from math import factorial, pi

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import magnitude, nearest, splat
from pymc_features.simulators.compiled.vector_math import polynomial
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number, write_lanes
from pymc_features.simulators.mean_squares.stencil import REACH, TERMS

# of x^2, for |x| <= pi / 2 and, hyperbolic, for |x| <= 0.3: what follows is below 1e-16
SINE = tuple((-1.0) ** k / factorial(2 * k + 1) for k in range(12))
COSINE = tuple((-1.0) ** k / factorial(2 * k) for k in range(12))
HYPERBOLIC_SINE = tuple(1.0 / factorial(2 * k + 1) for k in range(6))
HYPERBOLIC_COSINE = tuple(1.0 / factorial(2 * k) for k in range(8))
PI_HIGH = 3.141592653589793  # pi as a sum of two numbers
PI_LOW = 1.2246467991473532e-16
SIXTH = pi / 3.0  # the stencil's centre of time, see `stencil`


@jit
def sine_and_cosine(x):
    """sin x and cos x, to 1e-16 (1 + |x|)."""
    turns = nearest(x * (1.0 / np.pi))
    rest = (x - turns * PI_HIGH) - turns * PI_LOW
    odd = magnitude(turns - 2.0 * nearest(turns * 0.5))
    sign, square = 1.0 - 2.0 * odd, rest * rest
    return sign * (rest * polynomial(SINE, square)), sign * polynomial(COSINE, square)


@jit
def hyperbolic(x):
    """sinh x and cosh x, |x| <= 0.3."""
    square = x * x
    return x * polynomial(HYPERBOLIC_SINE, square), polynomial(HYPERBOLIC_COSINE, square)


@jit
def product(a_re, a_im, b_re, b_im):
    """Product of two complex vectors."""
    return a_re * b_re - a_im * b_im, a_re * b_im + a_im * b_re


@jit
def hold(sigma, omega, step):
    """E - 1, phi1 and phi2 of z = (-sigma + i omega) h, real and imaginary parts; NaN for z = 0.

    phi2 loses digits for small z, by as much as the sums in which it stands do not depend on it.
    """
    half_re, half_im = sigma * (-0.5 * step), omega * (0.5 * step)
    sinh, cosh = hyperbolic(half_re)
    sine, cosine = sine_and_cosine(half_im)
    growth = 2.0 * (sinh + cosh)
    grown_re, grown_im = product(growth * cosine, growth * sine, sinh * cosine, cosh * sine)
    z_re, z_im = 2.0 * half_re, 2.0 * half_im
    inverse = 1.0 / (z_re * z_re + z_im * z_im)
    z_re, z_im = z_re * inverse, (0.0 - z_im) * inverse
    one_re, one_im = product(grown_re, grown_im, z_re, z_im)
    two_re, two_im = product(one_re - 1.0, one_im, z_re, z_im)
    return grown_re, grown_im, one_re, one_im, two_re, two_im


@jit
def centre_turn(nu_re, nu_im):
    """exp(i nu pi / 3), |nu| in the square of side one about zero."""
    decay = nu_im * (-0.5 * SIXTH)
    sinh, cosh = hyperbolic(decay)
    sine, cosine = sine_and_cosine(nu_re * SIXTH)
    size = (sinh + cosh) * (sinh + cosh)
    return size * cosine, size * sine


@jit
def real_polynomial(coefficients, n, twice, norm, x_re, x_im):
    """Polynomial n with real coefficients at complex x; `twice` is 2 Re x and `norm` |x|^2."""
    first = n * TERMS
    ahead, here = splat(0.0), splat(read_number(coefficients, first + TERMS - 1))
    for k in range(TERMS - 2, 0, -1):
        ahead, here = here, read_number(coefficients, first + k) + twice * here - norm * ahead
    return read_number(coefficients, first) + x_re * here - norm * ahead, x_im * here


@jit
def write_weights(even, odd, parity, nu_re, nu_im, weights):
    """Write a_n(nu), n = -REACH ... REACH: real and imaginary parts in turn, (2 TAPS, LANES).

    `even`, `odd` and `weights` are addresses; `parity` is 1.0 for F and -1.0 for its derivative.
    """
    u_re, u_im = product(nu_re, nu_im, nu_re, nu_im)
    twice, norm = 2.0 * u_re, u_re * u_re + u_im * u_im
    for n in range(REACH + 1):
        even_re, even_im = real_polynomial(even, n, twice, norm, u_re, u_im)
        odd_re, odd_im = real_polynomial(odd, n, twice, norm, u_re, u_im)
        odd_re, odd_im = product(odd_re, odd_im, nu_re, nu_im)
        left_re, left_im = parity * (even_re - odd_re), parity * (even_im - odd_im)
        store_pair(weights, 2 * (REACH - n), left_re, left_im)
        store_pair(weights, 2 * (REACH + n), even_re + odd_re, even_im + odd_im)


@jit
def load_pair(address, row):
    """Real and imaginary part, in rows behind each other."""
    return read_lanes(address, row), read_lanes(address, row + 1)


@jit
def store_pair(address, row, re, im):
    """Write real and imaginary part into rows behind each other."""
    write_lanes(address, row, re)
    write_lanes(address, row + 1, im)
