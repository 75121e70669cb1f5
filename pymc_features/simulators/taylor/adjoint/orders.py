"""The recurrence of the coefficients of a chain in reverse.

With bars for derivatives of L, q_i = H^2/m_i Vbar_i,k+1 / (k + 1) and the forces' fbar_i = q_i-1 - q_i, the
law gives the bars of drift and drift rate, Dbar_i and Rbar_i, and

    Vbar_i,k   +=  Rbar_i - Rbar_i+1 + beta k_i / H (fbar_i - fbar_i+1) - alpha H Vbar_i,k+1 / (k + 1),
    Vbar_i,k-1 += (Dbar_i - Dbar_i+1) / k;    for k = 0 the displacements instead.

Bars of masses are those by ln(H^2/m_i), of dashpots by beta k_i / H, of `DRAG` by alpha H.
"""

from functools import cache

from pymc_features.simulators.compiled.jit import jit, unrolled
from pymc_features.simulators.compiled.vector import splat
from pymc_features.simulators.compiled.vector_memory import prefetch, read_lanes, write_lanes
from pymc_features.simulators.taylor.layout import (
    DASHPOT,
    DRAG,
    MOBILITY,
    RATE_SIGN,
    V_END,
    Z_END,
    Z_SIGN,
    U,
    add_lanes,
    layout_of,
)
from pymc_features.simulators.taylor.series import RATE, Spring, Z
from pymc_features.simulators.taylor.tape import width_of


def bars_of(series):
    """The recurrence with the series that its bars have, for their layout."""
    return series._replace(n_series=series.adjoint.n_series)


@cache
def damping_adjoint(series, k):
    """Return the function that adds to the bars of coefficients k what comes through modal ratios."""
    own, share = layout_of(bars_of(series)).record, -1.0 / (k + 1)

    @jit
    def undamp(bars, modal, n):
        for j in range(n):
            total = splat(0.0)
            for i in range(n):
                total = total + read_lanes(modal, i * n + j) * read_lanes(bars, (i + 1) * own + k + 1)
            add_lanes(bars, (j + 1) * own + k, share * total)

    return undamp


@cache
def damping_bars(series):
    """Return the function that adds what a step gives to the bars of H M^-1 C, (n, n) vectors."""
    record, own, order = layout_of(series).record, layout_of(bars_of(series)).record, series.order

    @jit
    def add_damping(address, bars, modal_bars, n):
        for i in range(n):
            for j in range(n):
                v, bar = (j + 1) * record, (i + 1) * own
                total = splat(0.0)
                for k in range(order):
                    share = -1.0 / (k + 1)
                    total = total + share * (read_lanes(address, v + k) * read_lanes(bars, bar + k + 1))
                add_lanes(modal_bars, i * n + j, total)

    return add_damping


@cache
def reverse_from(series, k):
    """Return the function that carries bars back over order k; for k > 1 over those below it as well, to 1.

    `push` is that of order 0 or 1; `ahead` is the address of the state that is restored next, which has most
    often left the caches.
    """
    length, record, entries, constants = layout_of(series)
    _, own, own_entries, own_constants = layout_of(bars_of(series))
    expand, share, last = unrolled(series.adjoint.expand), 1.0 / (k + 1), 1.0 / max(k, 1)
    rest = reverse_from(series, k - 1) if k > 1 else None
    kinks, undamp, width = series.branch is not None, damping_adjoint(series, k), width_of(series)

    @jit
    def order(address, bars, modal, n, push, ahead):
        drag = read_lanes(address, (n + 1) * record + DRAG)
        here, there = n * record, n * own
        bar = read_lanes(bars, there + k + 1) * share
        pull = read_lanes(address, here + entries + MOBILITY) * bar
        v, load = read_lanes(address, here + k), splat(push if k <= 1 else 0.0)
        upper_rate = upper_drift = drag_bar = splat(0.0)
        for i in range(n, 0, -1):
            if 0 < k <= width:
                prefetch(ahead, (i - 1) * width + k - 1)
            lower = here - record
            v_lower = read_lanes(address, lower + k)
            bar_lower = read_lanes(bars, there - own + k + 1) * share
            pull_lower = read_lanes(address, lower + entries + MOBILITY) * bar_lower
            if k == 0:
                drift = read_lanes(address, here + entries + U) - read_lanes(address, lower + entries + U)
            else:
                drift = (read_lanes(address, here + k - 1) - read_lanes(address, lower + k - 1)) * last
            rate, force = v - v_lower, pull_lower - pull
            spring = Spring(address, here + length, length, here + constants)
            of_spring = Spring(bars, there + length, length, there + own_constants)
            drift_bar, rate_bar = expand(spring, of_spring, k, drift, rate, force)
            rate_bar = rate_bar + read_lanes(address, here + entries + DASHPOT) * force
            if kinks:
                rate_bar = rate_bar + read_lanes(bars, there + length + RATE * length + k)
            drag_bar = drag_bar - bar * v
            by_mobility = bar * ((k + 1.0) * read_lanes(address, here + k + 1) + drag * v + load)
            add_lanes(bars, there + own_entries + MOBILITY, by_mobility)
            add_lanes(bars, there + own_entries + DASHPOT, force * rate)
            add_lanes(bars, there + k, rate_bar - upper_rate - drag * bar)
            if k == 0:
                add_lanes(bars, there + own_entries + U, drift_bar - upper_drift)
            else:
                add_lanes(bars, there + k - 1, (drift_bar - upper_drift) * last)
            upper_rate, upper_drift = rate_bar, drift_bar
            v, bar, pull, here, there = v_lower, bar_lower, pull_lower, lower, there - own
        add_lanes(bars, (n + 1) * own + DRAG, drag_bar)
        if modal != 0:
            undamp(bars, modal, n)
        if rest is not None:
            rest(address, bars, modal, n, push, ahead)

    return order


@cache
def spread_of(series):
    """Return the functions that begin and end the reverse of a step.

    Both ends of a step have bars of u, H v and z: in the entries `U`, `V_END` and `Z_END` of a record.
    """
    length, order, kinks = series.order + 1, series.order, series.branch is not None
    _, record, chain_entries, chain_constants = layout_of(series)
    _, own, entries, constants = layout_of(bars_of(series))
    z_first, rates = (1 + Z) * length, (1 + RATE) * length
    unbranch = jit(series.adjoint.branch) if kinks else None

    @jit
    def spread(bars, n):
        """Give bars to all coefficients: H v and z end with their sums, u grows by sum V_k / (k + 1)."""
        for i in range(1, n + 1):
            here = i * own
            v, u = read_lanes(bars, here + entries + V_END), read_lanes(bars, here + entries + U)
            for k in range(order + 1):
                write_lanes(bars, here + k, v + u * (1.0 / (k + 1)))
            if kinks:
                z = read_lanes(bars, here + entries + Z_END)
                for k in range(order + 1):
                    write_lanes(bars, here + z_first + k, z)
                    write_lanes(bars, here + rates + k, splat(0.0))

    @jit
    def collect(address, bars, n):
        """Take the bars of coefficients 0 for those of the state at the beginning."""
        for i in range(1, n + 1):
            here = i * own
            if kinks:
                at = i * record
                rate_sign = read_lanes(address, at + chain_entries + RATE_SIGN)
                z_sign = read_lanes(address, at + chain_entries + Z_SIGN)
                spring = Spring(address, at + length, length, at + chain_constants)
                of_spring = Spring(bars, here + length, length, here + constants)
                unbranch(spring, of_spring, rate_sign * z_sign, z_sign)
            write_lanes(bars, here + entries + V_END, read_lanes(bars, here))
            if kinks:
                write_lanes(bars, here + entries + Z_END, read_lanes(bars, here + z_first))

    return spread, collect
