"""What the products of a mode with data, inputs and other modes need of its pole, with derivatives by it."""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number, write_lanes, write_number
from pymc_features.simulators.mean_squares.gradient.memory import (
    AHEAD,
    BEFORE,
    DERIVATIVES,
    END,
    GROWN,
    HERE,
    LAST,
    N_NUMBERS,
    N_ROWS,
    NOW,
    OF_INPUT,
    SLOPE,
    TOTAL,
)
from pymc_features.simulators.mean_squares.stencil import TAPS
from pymc_features.simulators.mean_squares.waves import (
    SIXTH,
    centre_turn,
    hold,
    load_pair,
    product,
    store_pair,
    write_weights,
)

# Rows of `given`: before the interpolated functions F, before dF/dnu, before R[0], and the same of a start
BASE, BASE_SLOPE, BASE_NU, BACK, BACK_SLOPE, START, START_SLOPE, START_NU = range(0, 16, 2)


@jit
def inverse(re, im):
    """One over a complex number."""
    size = 1.0 / (re * re + im * im)
    return re * size, (0.0 - im) * size


@jit
def plus(a, b):
    """Sum of two complex numbers."""
    return a[0] + b[0], a[1] + b[1]


@jit
def minus(a, b):
    """Difference of two complex numbers."""
    return a[0] - b[0], a[1] - b[1]


@jit
def times(a, b):
    """Product of two complex numbers."""
    return product(a[0], a[1], b[0], b[1])


@jit
def scaled(factor, a):
    """A real number times a complex one."""
    return factor * a[0], factor * a[1]


@jit
def prepare(own, r):
    """Write what pole r of all lanes needs before its functions are interpolated."""
    row, to, h = N_NUMBERS * r, N_ROWS * r, own.step
    sigma, omega = load_pair(own.numbers, row)
    gain, nu = load_pair(own.numbers, row + 2), load_pair(own.numbers, row + 4)
    fineness = read_lanes(own.numbers, row + 8)
    write_weights(own.even, own.odd, 1.0, nu[0], nu[1], own.weights)
    write_weights(own.slope_even, own.slope_odd, -1.0, nu[0], nu[1], own.slopes)
    turn = times(centre_turn(nu[0], nu[1]), load_pair(own.numbers, row + 6))
    turn, lag = times(turn, gain), SIXTH * fineness  # d(turn)/dlambda = lag turn
    grown_re, grown_im, one_re, one_im, two_re, two_im = hold(sigma, omega, h)
    grown, one, two = (grown_re, grown_im), (one_re, one_im), (two_re, two_im)
    e, by_z = (grown_re + 1.0, grown_im), inverse(0.0 - sigma, omega)  # h / z
    one_slope = times(minus(e, one), by_z)
    two_slope = times((one_slope[0] - h * two[0], one_slope[1] - h * two[1]), scaled(1.0 / h, by_z))
    back = inverse(*e)
    base = times(times(times(one, one), back), turn)
    base_slope = plus(times(times(scaled(2.0, one), one_slope), times(back, turn)), scaled(lag - h, base))
    ahead, now = times(gain, minus(one, two)), times(gain, two)
    ahead_slope, now_slope = times(gain, minus(one_slope, two_slope)), times(gain, two_slope)
    back_slope = minus(times(ahead_slope, back), scaled(h, times(ahead, back)))
    start = scaled(0.0 - own.first, times(two, turn))
    start_slope = plus(scaled(0.0 - own.first, times(two_slope, turn)), scaled(lag, start))
    for at, number in (
        (BASE, base),
        (BASE_SLOPE, base_slope),
        (BASE_NU, (fineness * base[1], 0.0 - fineness * base[0])),  # dnu/dlambda = -i / spacing
        (BACK, times(ahead, back)),
        (BACK_SLOPE, back_slope),
        (START, start),
        (START_SLOPE, start_slope),
        (START_NU, (fineness * start[1], 0.0 - fineness * start[0])),
    ):
        store_pair(own.given, at, *number)
    store_pair(own.modes, to + GROWN, *grown)
    for at, number in ((AHEAD, ahead), (NOW, now)):
        store_pair(own.modes, to + at, *number)
    for at, number in ((AHEAD, ahead_slope), (NOW, now_slope)):
        store_pair(own.modes, to + DERIVATIVES + at, *number)


@jit
def interpolate(own, entry, lane):
    """One vector of functions and one of derivatives by nu, from the nodes that begin at `entry`."""
    zero = splat(0.0)
    re, im, other_re, other_im = zero, zero, zero, zero
    d_re, d_im, d_other_re, d_other_im = zero, zero, zero, zero
    weight = lane
    for _ in range(TAPS):
        f_re, f_im = read_lanes(own.values, entry), read_lanes(own.values, entry + own.vectors)
        a = splat(read_number(own.weights, weight))
        re, im = re + a * f_re, im + a * f_im
        a = splat(read_number(own.weights, weight + LANES))
        other_re, other_im = other_re + a * f_im, other_im + a * f_re
        a = splat(read_number(own.slopes, weight))
        d_re, d_im = d_re + a * f_re, d_im + a * f_im
        a = splat(read_number(own.slopes, weight + LANES))
        d_other_re, d_other_im = d_other_re + a * f_im, d_other_im + a * f_re
        entry, weight = entry + own.node, weight + 2 * LANES
    return re - other_re, im + other_im, d_re - d_other_re, d_im + d_other_im


@jit
def take_functions(own, lane, entry):
    """Interpolate the functions of a pole of one lane into `raw`; `entry` as in `evaluate`."""
    n_functions = own.n_sensors + 2
    for i in range(own.blocks):
        for v in range(own.vectors):
            re, im, d_re, d_im = interpolate(own, entry + 2 * i * own.vectors + v, lane)
            write_lanes(own.found, v, re)
            write_lanes(own.found, own.vectors + v, im)
            write_lanes(own.found, 2 * own.vectors + v, d_re)
            write_lanes(own.found, 3 * own.vectors + v, d_im)
        for f in range(n_functions):
            to = 4 * (i * n_functions + f)
            for part in range(4):
                number = read_number(own.found, part * own.vectors * LANES + f)
                write_number(own.raw, (to + part) * LANES + lane, number)


@jit
def function_of(own, f):
    """C times function f of a pole, and C times its derivative by lambda."""
    f_re, f_im = load_pair(own.raw, 4 * f)
    raw, slope = (f_re, f_im), load_pair(own.raw, 4 * f + 2)
    at_zero, given = read_number(own.lag_zero, f), own.given
    found = minus(times(load_pair(given, BASE), raw), scaled(at_zero, load_pair(given, BACK)))
    derived = plus(times(load_pair(given, BASE_SLOPE), raw), times(load_pair(given, BASE_NU), slope))
    derived = minus(derived, scaled(at_zero, load_pair(given, BACK_SLOPE)))
    if own.blocks > 1:
        at = 4 * (own.n_sensors + 2 + f)
        raw, slope = load_pair(own.raw, at), load_pair(own.raw, at + 2)
        found = plus(found, times(load_pair(given, START), raw))
        derived = plus(derived, times(load_pair(given, START_SLOPE), raw))
        derived = plus(derived, times(load_pair(given, START_NU), slope))
    return found, derived


@jit
def finish(own, r):
    """Write what the products of pole r with others need, and begin the sums of w times its output."""
    m, n_sensors, to, h, zero = own.n_modes, own.n_sensors, N_ROWS * r, own.step, splat(0.0)
    total, slope, through, at_end = (zero, zero), (zero, zero), zero, zero
    for j in range(n_sensors):
        found, derived = function_of(own, j)
        write_lanes(own.data, j * m + r, 2.0 * found[0])
        share, factor = read_lanes(own.scaled, j * m + r), read_lanes(own.factors, j)
        total = minus(total, scaled(share * factor, found))
        slope = minus(slope, scaled(share * factor, derived))
        through = through + share * factor * read_lanes(own.feed, j)
        at_end = at_end - share * read_lanes(own.ends, j)
    q, q_slope = function_of(own, n_sensors)
    x, x_slope = function_of(own, n_sensors + 1)
    total = plus(total, plus(scaled(through, q), scaled(at_end, x)))
    slope = plus(slope, plus(scaled(through, q_slope), scaled(at_end, x_slope)))
    modes = own.modes
    store_pair(modes, to + TOTAL, *total)
    store_pair(modes, to + SLOPE, *slope)
    store_pair(modes, to + OF_INPUT, *q)
    store_pair(modes, to + END, *x)
    e_re, e_im = load_pair(modes, to + GROWN)
    e = e_re + 1.0, e_im
    ahead, now = load_pair(modes, to + AHEAD), load_pair(modes, to + NOW)
    ahead_slope, now_slope = (
        load_pair(modes, to + DERIVATIVES + AHEAD),
        load_pair(modes, to + DERIVATIVES + NOW),
    )
    rest = minus(q, scaled(own.last, x))
    before = times(e, rest)
    before_slope = plus(scaled(h, before), times(e, minus(q_slope, scaled(own.last, x_slope))))
    before, before_slope = (
        plus(before, scaled(0.5 * own.early, ahead)),
        plus(before_slope, scaled(0.5 * own.early, ahead_slope)),
    )
    by_ahead, by_now = own.kick * own.first, own.kick * own.second - 0.5 * own.late
    here = plus(q, plus(scaled(by_ahead, ahead), scaled(by_now, now)))
    here_slope = plus(q_slope, plus(scaled(by_ahead, ahead_slope), scaled(by_now, now_slope)))
    last = times(e, x)
    last_slope = plus(scaled(h, last), times(e, x_slope))
    for at, number, derived in (
        (LAST, last, last_slope),
        (BEFORE, before, before_slope),
        (HERE, here, here_slope),
    ):
        store_pair(modes, to + at, *number)
        store_pair(modes, to + DERIVATIVES + at, *derived)
