"""Products of the outputs of two modes, from the recursion times itself."""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import magnitude, splat, square_root
from pymc_features.simulators.compiled.vector_memory import read_lanes, write_lanes
from pymc_features.simulators.mean_squares.waves import load_pair


@jit
def cross_terms(sums, a, b, at, to):
    """Add the four real products of complex numbers of `a` and `b`, and of `b` and `a`, to sums of such."""
    ac, bd, ad, bc = sums
    x_re, x_im = load_pair(a, at)
    y_re, y_im = load_pair(b, to)
    ac, bd = ac + x_re * y_re, bd + x_im * y_im
    ad, bc = ad + x_re * y_im, bc + x_im * y_re
    x_re, x_im = load_pair(b, at)
    y_re, y_im = load_pair(a, to)
    ac, bd = ac + x_re * y_re, bd + x_im * y_im
    return ac, bd, ad + x_re * y_im, bc + x_im * y_re


@jit
def pair_product(own, r, q):
    """o_r'o_q, without the shapes."""
    x_re, x_im = load_pair(own.last, 2 * r)
    y_re, y_im = load_pair(own.last, 2 * q)
    zero = splat(0.0)
    sums = (zero - x_re * y_re, zero - x_im * y_im, zero - x_re * y_im, zero - x_im * y_re)
    n_phases = own.n_inputs * own.stride
    for i in range(n_phases):
        sums = cross_terms(sums, own.ahead, own.before, 2 * (r * n_phases + i), 2 * (q * n_phases + i))
    for i in range(own.n_inputs):
        sums = cross_terms(sums, own.now, own.here, 2 * (r * own.n_inputs + i), 2 * (q * own.n_inputs + i))
    ac, bd, ad, bc = sums
    a, b = load_pair(own.grown, 2 * r)
    c, d = load_pair(own.grown, 2 * q)
    # 1 - E_r E_q and 1 - E_r conj(E_q), from E - 1
    whole = a + c + a * c
    first_re, first_im = zero - (whole - b * d), zero - (b + d + a * d + b * c)
    second_re, second_im = zero - (whole + b * d), zero - (b - d - a * d + b * c)
    first = (ac - bd) * first_re + (ad + bc) * first_im
    second = (ac + bd) * second_re + (bc - ad) * second_im
    first = first / (first_re * first_re + first_im * first_im)
    second = second / (second_re * second_re + second_im * second_im)
    return 2.0 * (first + second)


@jit
def own_size(own, r):
    """Root of a bound on the terms of o_r'o_r: what its rounding errors are relative to."""
    x_re, x_im = load_pair(own.last, 2 * r)
    total = x_re * x_re + x_im * x_im
    for a, b, n in (
        (own.ahead, own.before, own.n_inputs * own.stride),
        (own.now, own.here, own.n_inputs),
    ):
        for at in range(2 * r * n, 2 * (r + 1) * n, 2):
            a_size = magnitude(read_lanes(a, at)) + magnitude(read_lanes(a, at + 1))
            b_size = magnitude(read_lanes(b, at)) + magnitude(read_lanes(b, at + 1))
            total = total + 2.0 * a_size * b_size
    a, b = load_pair(own.grown, 2 * r)
    return 2.0 * square_root(total / magnitude(2.0 * a + a * a + b * b))


@jit
def combine(own, n_poles):
    """Add the products of all pairs of poles to the sums of squares."""
    n_sensors = own.n_sensors
    for r in range(n_poles):
        size = own_size(own, r)
        for j in range(n_sensors):
            share = magnitude(read_lanes(own.shapes, r * n_sensors + j)) * size
            write_lanes(own.spread, j, read_lanes(own.spread, j) + share)
        for q in range(r + 1):
            both = pair_product(own, r, q)
            both = both + both if q < r else both
            for j in range(n_sensors):
                share = read_lanes(own.shapes, r * n_sensors + j) * read_lanes(own.shapes, q * n_sensors + j)
                write_lanes(own.squares, j, read_lanes(own.squares, j) + both * share)
