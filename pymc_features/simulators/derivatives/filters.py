"""Modes as filters of second order, and the derivatives of their coefficients, a mode in each lane.

With the transition A of a step (`recursion.py`), t = tr A and the determinant e^-d of A, a mode's output is
combined from one sequence, w[k+2] = t w[k+1] - e^-d w[k] + a[k]. It is carried as W = w[k+1] and the
difference E = w[k+1] - sigma w[k], with sigma = 1, or -1 where t is negative:

    E' = sigma e^-d E - kappa W + a,   W' = sigma W + E',   kappa = sigma (1 + e^-d) - t,
    output = c_w W + c_e E + c_a a,

so that no digits are lost in slow modes, nor in those near a multiple of half the sampling rate: kappa and
the c are combined from quantities that are small together with them. A change of kappa and of e^-d changes
the output by

    -dkappa V + sigma d(e^-d) G,   where V and G follow from the output as W and E do from a.

A structure is at rest at the first sample though the ground is accelerated there already: what the filter has
too much is that acceleration times c_w' W + c_e' E of the recursion without input from W = E = 1.

Derivatives with respect to s = (omega h)^2 and d = D h are carried along as in `first_order_hold`'s complex
steps, as numbers (x, dx/ds, dx/dd).
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import highest, splat, where_less
from pymc_features.simulators.compiled.vector_math import exponential, larger
from pymc_features.simulators.compiled.vector_memory import scale, write_lanes
from pymc_features.simulators.oscillators.arguments import (
    ABSOLUTE_ACCELERATION,
    RELATIVE_ACCELERATION,
    RELATIVE_DISPLACEMENT,
)
from pymc_features.simulators.oscillators.hold import TAYLOR_TERMS
from pymc_features.simulators.oscillators.table import SMALLEST

# Rows of a mode's coefficients: sigma e^-d, kappa, sigma, c_w, c_e, c_a, c_w', c_e', and the derivatives of
# kappa, c_w, c_e, c_a, c_w' and c_e' with respect to s, then with respect to d
DECAY, KAPPA, SIGN, BY_W, BY_E, BY_A, START_W, START_E = range(8)
BY_S, BY_D = 8, 14


@jit
def plus(x, y):
    """x + y with derivatives."""
    return x[0] + y[0], x[1] + y[1], x[2] + y[2]


@jit
def minus(x, y):
    """x - y with derivatives."""
    return x[0] - y[0], x[1] - y[1], x[2] - y[2]


@jit
def times(x, y):
    """x y with derivatives."""
    return x[0] * y[0], x[0] * y[1] + x[1] * y[0], x[0] * y[2] + x[2] * y[0]


@jit
def scaled(factor, x):
    """A constant, or a vector of them, times x, with derivatives."""
    return factor * x[0], factor * x[1], factor * x[2]


@jit
def one_plus(x):
    """1 + x with derivatives."""
    return x[0] + 1.0, x[1], x[2]


@jit
def chosen(a, b, x, y):
    """x in the lanes where a < b, y elsewhere, with derivatives."""
    return where_less(a, b, x[0], y[0]), where_less(a, b, x[1], y[1]), where_less(a, b, x[2], y[2])


@jit
def hold_functions(s, d):
    """phi0, phi1 and phi2 of F, pairs (a, b) for a I + b F, as in `recursion.first_order_hold`."""
    zero, one = splat(0.0), splat(1.0)
    small_s, small_d, halvings = s[0], d[0], zero
    while highest(larger(small_s, small_d * small_d)) > 0.0625:
        size, limit = larger(small_s, small_d * small_d), splat(0.0625)
        halvings = where_less(limit, size, halvings + 1.0, halvings)
        small_s = where_less(limit, size, 0.25 * small_s, small_s)
        small_d = where_less(limit, size, 0.5 * small_d, small_d)
    half = scale(one, zero - halvings)
    s, d = (small_s, half * half, zero), (small_d, zero, half)
    a2, b2 = (one, zero, zero), (zero, zero, zero)
    for k in range(TAYLOR_TERMS, 2, -1):
        below = scaled(-1.0 / k, times(s, b2))
        a2, b2 = one_plus(below), scaled(1.0 / k, minus(a2, times(d, b2)))
    a2, b2 = scaled(0.5, a2), scaled(0.5, b2)
    a1, b1 = one_plus(scaled(-1.0, times(s, b2))), minus(a2, times(d, b2))
    a0, b0 = one_plus(scaled(-1.0, times(s, b1))), minus(a1, times(d, b1))
    for i in range(int(highest(halvings))):
        grown = one_plus(a0)
        mixed, s_b0 = minus(grown, times(d, b0)), scaled(-1.0, times(s, b0))
        next_a2 = scaled(0.25, plus(plus(times(grown, a2), times(s_b0, b2)), a1))
        next_b2 = scaled(0.125, plus(plus(times(mixed, b2), times(b0, a2)), b1))
        next_a1 = scaled(0.5, plus(times(grown, a1), times(s_b0, b1)))
        next_b1 = scaled(0.25, plus(times(mixed, b1), times(b0, a1)))
        next_b0 = scaled(0.5, times(b0, minus(scaled(2.0, a0), times(d, b0))))
        next_a0 = plus(times(a0, a0), times(s_b0, b0))
        here = splat(float(i))
        a2, b2 = chosen(here, halvings, next_a2, a2), chosen(here, halvings, next_b2, b2)
        a1, b1 = chosen(here, halvings, next_a1, a1), chosen(here, halvings, next_b1, b1)
        a0, b0 = chosen(here, halvings, next_a0, a0), chosen(here, halvings, next_b0, b0)
        s, d = chosen(here, halvings, scaled(4.0, s), s), chosen(here, halvings, scaled(2.0, d), d)
    return a0, b0, a1, b1, a2, b2


@jit
def output_row(quantity, s, d, step):
    """What stands before q and q' in a mode's output, with derivatives, and before a."""
    zero = splat(0.0)
    none = (zero, zero, zero)
    if quantity == RELATIVE_DISPLACEMENT:
        return (splat(step * step), zero, zero), none, zero
    if quantity in (ABSOLUTE_ACCELERATION, RELATIVE_ACCELERATION):
        return scaled(-1.0, s), scaled(-1.0, d), splat(-1.0)
    return none, (splat(step), zero, zero), zero


@jit
def numerators(load, row, sign, transition, low, high):
    """c_w and c_e under a load on (q, q'): of what `row` puts out of w and E, see `write_filter`."""
    (load_q, load_p), (row_q, row_p), (qq, qp, pq, pp) = load, row, transition
    w_q = plus(times(high, load_q), scaled(sign, times(qp, load_p)))
    w_p = plus(times(low, load_p), scaled(sign, times(pq, load_q)))
    e_q = minus(times(pp, load_q), times(qp, load_p))
    e_p = minus(times(qq, load_p), times(pq, load_q))
    by_e = plus(times(row_q, e_q), times(row_p, e_p))
    return plus(times(row_q, w_q), times(row_p, w_p)), scaled(sign, by_e)


@jit
def write_filter(omega, damping, step, quantity, coefficients, first):
    """Write the coefficients of one mode of each lane, vectors `first` ... `first + 19` at an address.

    (q, q') = (sigma I + A - t I) load sigma W + sigma (t I - A) load E, with A = [[qq, qp], [pq, pp]].

    Parameters
    ----------
    omega, damping : vector
        [rad/s] and D [1/s].
    step : float
        Of the recursion [s].
    quantity : int
        Position in `QUANTITIES`.
    """
    zero, one = splat(0.0), splat(1.0)
    root = larger(omega * step, splat(SMALLEST))
    s, d = (root * root, one, zero), (damping * step, zero, one)
    qq, qp, a1, b1, a2, b2 = hold_functions(s, d)
    pq, pp = scaled(-1.0, times(s, qp)), minus(qq, times(d, qp))
    now_q, after_q, after_p = minus(b2, b1), scaled(-1.0, b2), minus(times(d, b2), a2)
    now_p = minus(minus(a2, a1), times(d, now_q))
    load_q = plus(plus(times(qq, after_q), times(qp, after_p)), now_q)
    load_p = plus(plus(times(pq, after_q), times(pp, after_p)), now_p)
    trace = qq[0] + pp[0]
    sign, u = where_less(trace, zero, zero - one, one), times(s, b1)  # u = 1 - qq
    low = chosen(trace, zero, one_plus(qq), u)
    high = chosen(trace, zero, one_plus(pp), plus(u, times(d, qp)))
    kappa = scaled(sign, minus(times(low, high), times(pq, qp)))
    row_q, row_p, direct = output_row(quantity, s, d, step)
    given = (row_q, row_p), sign, (qq, qp, pq, pp), low, high
    by_w, by_e = numerators((load_q, load_p), *given)
    start_w, start_e = numerators((after_q, after_p), *given)
    by_a = plus(times(row_q, after_q), times(row_p, after_p))
    write_lanes(coefficients, first + DECAY, sign * exponential(zero - d[0]))
    write_lanes(coefficients, first + SIGN, sign)
    write_lanes(coefficients, first + BY_A, by_a[0] + direct)
    for row, number in ((KAPPA, kappa), (BY_W, by_w), (BY_E, by_e), (START_W, start_w), (START_E, start_e)):
        write_lanes(coefficients, first + row, number[0])
    changing = (kappa, by_w, by_e, by_a, start_w, start_e)
    for i in range(6):
        write_lanes(coefficients, first + BY_S + i, changing[i][1])
        write_lanes(coefficients, first + BY_D + i, changing[i][2])
