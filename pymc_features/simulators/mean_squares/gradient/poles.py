"""What the products of a mode with data, inputs and other modes need of its pole, with derivatives by it."""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number, write_lanes, write_number
from pymc_features.simulators.mean_squares.gradient.memory import (
    AHEAD,
    BEFORE,
    END,
    GROWN,
    HERE,
    LAST,
    N_NUMBERS,
    NOW,
    OF_INPUT,
    OF_PHASE,
    PHASES,
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
    row, to, h = N_NUMBERS * r, own.n_rows * r, own.step
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
    first = 0.0 - read_number(own.first, 0)
    start = scaled(first, times(two, turn))
    start_slope = plus(scaled(first, times(two_slope, turn)), scaled(lag, start))
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
    store_pair(own.modes, to + NOW, *now)
    store_pair(own.modes, to + own.derivatives + NOW, *now_slope)
    # each phase p, from the last: E^(c-1-p) phi1^2, or rho for phi1^2; E^(c-p) - 1
    square, square_slope = times(times(one, one), gain), times(scaled(2.0, one), times(one_slope, gain))
    whole = grown
    for p in range(own.stride - 1, 0, -1):
        at = to + PHASES + OF_PHASE * p + AHEAD
        store_pair(own.modes, at, *square)
        store_pair(own.modes, at + own.derivatives, *square_slope)
        square_slope = times(e, plus(square_slope, scaled(h, square)))
        ahead_slope = times(e, plus(ahead_slope, scaled(h, ahead)))
        square, ahead = times(e, square), times(e, ahead)
        whole = plus(plus(whole, grown), times(whole, grown))
    store_pair(own.modes, to + GROWN, *whole)
    store_pair(own.modes, to + PHASES + AHEAD, *ahead)
    store_pair(own.modes, to + own.derivatives + PHASES + AHEAD, *ahead_slope)


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
    n_functions = own.n_functions
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
        at = 4 * (own.n_functions + f)
        raw, slope = load_pair(own.raw, at), load_pair(own.raw, at + 2)
        found = plus(found, times(load_pair(given, START), raw))
        derived = plus(derived, times(load_pair(given, START_SLOPE), raw))
        derived = plus(derived, times(load_pair(given, START_NU), slope))
    return found, derived


@jit
def finish(own, r):
    """Write what the products of pole r with others need, and begin the sums of w times its output."""
    m, n_sensors, stride, to, zero = own.n_modes, own.n_sensors, own.stride, own.n_rows * r, splat(0.0)
    total, slope, through, at_end = (zero, zero), (zero, zero), zero, zero
    for j in range(n_sensors):
        found, derived = function_of(own, j)
        write_lanes(own.data, j * m + r, 2.0 * found[0])
        share, factor = read_lanes(own.scaled, j * m + r), read_lanes(own.factors, j)
        total = minus(total, scaled(share * factor, found))
        slope = minus(slope, scaled(share * factor, derived))
        through = through + share * factor * read_lanes(own.feed, j)
        at_end = at_end - share * read_lanes(own.ends, j)
    q, q_slope = function_of(own, own.of_input)
    x, x_slope = function_of(own, n_sensors + stride)
    total = plus(total, plus(scaled(through, q), scaled(at_end, x)))
    slope = plus(slope, plus(scaled(through, q_slope), scaled(at_end, x_slope)))
    modes = own.modes
    store_pair(modes, to + TOTAL, *total)
    store_pair(modes, to + SLOPE, *slope)
    store_pair(modes, to + OF_INPUT, *q)
    store_pair(modes, to + END, *x)
    h, derivatives, (e_re, e_im) = own.step * stride, own.derivatives, load_pair(modes, to + GROWN)
    e = e_re + 1.0, e_im
    now, now_slope = load_pair(modes, to + NOW), load_pair(modes, to + derivatives + NOW)
    kick, kick_slope = scaled(own.second, now), scaled(own.second, now_slope)  # v[1]
    for p in range(stride):
        at, first = to + PHASES + OF_PHASE * p + AHEAD, read_number(own.first, p)
        kick = plus(kick, scaled(first, load_pair(modes, at)))
        kick_slope = plus(kick_slope, scaled(first, load_pair(modes, at + derivatives)))
    for p in range(stride):
        q, q_slope = function_of(own, n_sensors + p)
        final, at = read_number(own.last, p), to + PHASES + OF_PHASE * p + BEFORE
        before = times(e, minus(q, scaled(final, x)))
        before_slope = plus(scaled(h, before), times(e, minus(q_slope, scaled(final, x_slope))))
        for k in range(stride):
            early, ahead = 0.5 * read_number(own.early, p * stride + k), to + PHASES + OF_PHASE * k + AHEAD
            before = plus(before, scaled(early, load_pair(modes, ahead)))
            before_slope = plus(before_slope, scaled(early, load_pair(modes, ahead + derivatives)))
        store_pair(modes, at, *before)
        store_pair(modes, at + derivatives, *before_slope)
    q, q_slope = function_of(own, n_sensors)
    here = plus(q, plus(scaled(own.kick, kick), scaled(-0.5 * own.late, now)))
    here_slope = plus(q_slope, plus(scaled(own.kick, kick_slope), scaled(-0.5 * own.late, now_slope)))
    last = times(e, x)
    last_slope = plus(scaled(h, last), times(e, x_slope))
    for at, number, derived in ((LAST, last, last_slope), (HERE, here, here_slope)):
        store_pair(modes, to + at, *number)
        store_pair(modes, to + derivatives + at, *derived)
