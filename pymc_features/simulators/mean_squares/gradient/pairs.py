"""Products of the outputs of two modes and their derivatives by both poles; see `mean_squares.pairs`."""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import magnitude, splat, square_root
from pymc_features.simulators.compiled.vector_memory import read_lanes, write_lanes
from pymc_features.simulators.mean_squares.gradient.memory import (
    AHEAD,
    BEFORE,
    GROWN,
    HERE,
    LAST,
    NOW,
    OF_PHASE,
    PHASES,
    SLOPE,
    TOTAL,
)
from pymc_features.simulators.mean_squares.gradient.poles import inverse, plus, scaled, times
from pymc_features.simulators.mean_squares.waves import load_pair, store_pair


@jit
def add_products(sums, a, b):
    """Add the four real products of two complex numbers to sums of such."""
    return sums[0] + a[0] * b[0], sums[1] + a[1] * b[1], sums[2] + a[0] * b[1], sums[3] + a[1] * b[0]


@jit
def numerators(modes, at, to, stride):
    """N of rows from `at` on with those from `to` on, and with their conjugates."""
    x, y, zero = load_pair(modes, at + LAST), load_pair(modes, to + LAST), splat(0.0)
    sums = add_products((zero, zero, zero, zero), (zero - x[0], zero - x[1]), y)
    for phase in range(PHASES, PHASES + OF_PHASE * stride, OF_PHASE):
        ahead, before = phase + AHEAD, phase + BEFORE
        sums = add_products(sums, load_pair(modes, at + ahead), load_pair(modes, to + before))
        sums = add_products(sums, load_pair(modes, at + before), load_pair(modes, to + ahead))
    sums = add_products(sums, load_pair(modes, at + NOW), load_pair(modes, to + HERE))
    ac, bd, ad, bc = add_products(sums, load_pair(modes, at + HERE), load_pair(modes, to + NOW))
    return (ac - bd, ad + bc), (ac + bd, bc - ad)


@jit
def add_to(address, row, number):
    """Add a complex number to one in memory."""
    re, im = load_pair(address, row)
    store_pair(address, row, re + number[0], im + number[1])


@jit
def take_pair(own, r, q):
    """Add the products of o_r and o_q, and of their derivatives, to the sums of w times the outputs."""
    m, modes, at, to, zero = own.n_modes, own.modes, own.n_rows * r, own.n_rows * q, splat(0.0)
    stride, h = own.stride, own.step * own.stride
    plain, conjugate = numerators(modes, at, to, stride)
    left, left_conjugate = numerators(modes, at + own.derivatives, to, stride)
    right, right_conjugate = numerators(modes, at, to + own.derivatives, stride)
    (a, b), (c, d) = load_pair(modes, at + GROWN), load_pair(modes, to + GROWN)
    # E_r E_q - 1 and E_r conj(E_q) - 1, from E - 1
    whole = a + c + a * c
    growth = whole - b * d, b + d + a * d + b * c
    decay = whole + b * d, b - d - a * d + b * c
    over, over_conjugate = (
        inverse(zero - growth[0], zero - growth[1]),
        inverse(zero - decay[0], zero - decay[1]),
    )
    plain, conjugate = times(plain, over), times(conjugate, over_conjugate)
    grown = scaled(h, times((growth[0] + 1.0, growth[1]), plain))
    decayed = scaled(h, times((decay[0] + 1.0, decay[1]), conjugate))
    left, left_conjugate = (
        times(plus(left, grown), over),
        times(plus(left_conjugate, decayed), over_conjugate),
    )
    share, both = zero, 2.0 * (plain[0] + conjugate[0])
    for j in range(own.n_sensors):
        of_r, of_q = read_lanes(own.scaled, j * m + r), read_lanes(own.scaled, j * m + q)
        share = share + read_lanes(own.factors, j) * (of_r * of_q)
        write_lanes(own.products, j * m + r, read_lanes(own.products, j * m + r) + of_q * both)
        if q < r:
            write_lanes(own.products, j * m + q, read_lanes(own.products, j * m + q) + of_r * both)
    add_to(modes, at + TOTAL, scaled(share, plus(plain, conjugate)))
    add_to(modes, at + SLOPE, scaled(share, plus(left, left_conjugate)))
    if q < r:
        right = times(plus(right, grown), over)
        right_conjugate = times(plus(right_conjugate, decayed), over_conjugate)
        other = plain[0] + conjugate[0], plain[1] - conjugate[1]
        other_slope = right[0] + right_conjugate[0], right[1] - right_conjugate[1]
        add_to(modes, to + TOTAL, scaled(share, other))
        add_to(modes, to + SLOPE, scaled(share, other_slope))


@jit
def own_size(own, r):
    """As `mean_squares.pairs.own_size`."""
    at, modes, phases = own.n_rows * r, own.modes, OF_PHASE * own.stride
    x_re, x_im = load_pair(modes, at + LAST)
    total = x_re * x_re + x_im * x_im
    for first, other, end in ((PHASES + AHEAD, BEFORE - AHEAD, phases), (NOW, HERE - NOW, 1)):
        for a in range(at + first, at + first + end, OF_PHASE):
            a_size = magnitude(read_lanes(modes, a)) + magnitude(read_lanes(modes, a + 1))
            b_size = magnitude(read_lanes(modes, a + other)) + magnitude(read_lanes(modes, a + other + 1))
            total = total + 2.0 * a_size * b_size
    a, b = load_pair(modes, at + GROWN)
    return 2.0 * square_root(total / magnitude(2.0 * a + a * a + b * b))
