"""The recurrence of the coefficients of a chain in reverse.

With bars for derivatives of L, q_i = H^2/m_i Vbar_i,k+1 / (k + 1) and the forces' fbar_i = q_i-1 - q_i, the
law gives the bars of drift and drift rate, Dbar_i and Rbar_i, and

    Vbar_i,k   +=  Rbar_i - Rbar_i+1 + beta k_i / H (fbar_i - fbar_i+1) - alpha H Vbar_i,k+1 / (k + 1),
    Vbar_i,k-1 += (Dbar_i - Dbar_i+1) / k;    for k = 0 the displacements instead.

Both ends of a step have bars of u, H v and z: in the entries `U`, `V_END` and `Z_END` of a record. At the end
H v and z are the sums of their coefficients, and u has grown by sum V_k / (k + 1): with these shares the bars
of the coefficients begin, each where it is first added to. These pass: they lie in a ring of springs, as many
as a block and those behind it, which stays in the first cache. What masses and springs get is summed up over
all orders where order 0 is reached: by ln(H^2/m_i), of dashpots by beta k_i / H, of `DRAG` by alpha H.
"""

from functools import cache
from typing import NamedTuple

from pymc_features.simulators.compiled.jit import jit, unrolled
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import prefetch, read_lanes, read_number, write_lanes
from pymc_features.simulators.taylor.ground.projection import DEGREE
from pymc_features.simulators.taylor.layout import (
    CURVED,
    DASHPOT,
    DRAG,
    HAS_KINK,
    MOBILITY,
    N_CHAIN_ENTRIES,
    RATE_SIGN,
    V_END,
    Z_END,
    Z_SIGN,
    U,
    add_lanes,
    layout_of,
    load_of,
)
from pymc_features.simulators.taylor.series import RATE, Spring, Z
from pymc_features.simulators.taylor.tape import width_of

BLOCK = 4  # springs
OF_U = 2  # where the bar of u at the beginning of a step is kept, behind those of coefficients 0 and 1


def bars_of(series):
    """The recurrence with the series of bars that are kept for each spring, for their layout.

    In place of coefficients of H v stand bars of its coefficients 0 and 1, and of u, at the beginning of a
    step: those of the misfits. Springs with kinks have series of bars of drift rate and z to begin with.
    """
    return series._replace(n_series=0 if series.branch is None else 2)


class Ring(NamedTuple):
    """Sizes in vectors: of the series of bars of one spring, H v first and forces last, and of the ring."""

    width: int
    springs: int


def ring_of(series):
    """The ring of bars that pass; all springs are in it where there are fewer, or damping by modal ratios."""
    return Ring((2 + series.adjoint.n_series) * (series.order + 1), BLOCK + series.order)


def passing_size(series, n, has_modal_damping) -> int:
    """Vectors of the bars that pass."""
    ring = ring_of(series)
    return ring.width * (n + 1 if has_modal_damping or n < ring.springs else ring.springs)


@cache
def places_of(series):
    """Return the function for the beginning and the end of the ring, behind the bars that are kept."""
    own, (width, springs) = layout_of(bars_of(series)).record, ring_of(series)
    behind = load_of(series)

    @jit
    def places(modal, n):
        first = (n + 1) * own + behind
        return first, first + width * (n + 1 if modal != 0 or n < springs else springs)

    return places


@cache
def damping_adjoint(series, k):
    """Return the function that adds to the bars of coefficients k what comes through modal ratios."""
    _, own, entries, _ = layout_of(bars_of(series))
    share, places, width = -1.0 / (k + 1), places_of(series), ring_of(series).width

    @jit
    def undamp(bars, modal, n):
        first = places(modal, n)[0]
        for j in range(n):
            total = splat(0.0)
            for i in range(n):
                total = total + read_lanes(modal, i * n + j) * read_lanes(
                    bars, first + (i + 1) * width + k + 1
                )
            to = (j + 1) * own + entries + V_END if k == 0 else first + (j + 1) * width + k
            add_lanes(bars, to, share * total)

    return undamp


@cache
def damping_bars(series):
    """Return the function that adds what a step gives to the bars of H M^-1 C, (n, n) vectors."""
    record, order = layout_of(series).record, series.order
    places, width = places_of(series), ring_of(series).width

    @jit
    def add_damping(address, bars, modal_bars, n):
        first = places(modal_bars, n)[0]
        for i in range(n):
            for j in range(n):
                v, bar = (j + 1) * record, first + (i + 1) * width
                total = splat(0.0)
                for k in range(order):
                    share = -1.0 / (k + 1)
                    total = total + share * (read_lanes(address, v + k) * read_lanes(bars, bar + k + 1))
                add_lanes(modal_bars, i * n + j, total)

    return add_damping


@cache
def reverse_from(series, k):
    """Return the function that carries bars of a block back over order k; for k > 1 over those below, to 1.

    Order k stays one spring behind order k + 1, as in `taylor/orders.py`. `ahead` is the address of the state
    that is restored next, which has most often left the caches.
    """
    length, record, entries, constants = layout_of(series)
    _, own, own_entries, own_constants = layout_of(bars_of(series))
    expand, share, last = unrolled(series.adjoint.expand), 1.0 / (k + 1), 1.0 / max(k, 1)
    rest = reverse_from(series, k - 1) if k > 1 else None
    kinks, undamp, width = series.branch is not None, damping_adjoint(series, k), width_of(series)
    is_last, left, places = k == series.order - 1, N_CHAIN_ENTRIES + 2 * k, places_of(series)
    row, forces = ring_of(series).width, ring_of(series).width - length
    rates, zs = (1 + RATE) * length + k, (1 + Z) * length + k

    @jit
    def begin(bars, there, at):
        """Vbar_k+1 / (k + 1)."""
        if not is_last:
            return share * read_lanes(bars, at + k + 1)
        v, u = read_lanes(bars, there + own_entries + V_END), read_lanes(bars, there + own_entries + U)
        bar = v + splat(1.0 / (k + 2)) * u
        write_lanes(bars, at + k + 1, bar)
        return share * bar

    @jit
    def order(address, bars, modal, n, ahead, high, size):
        end, here, there = (n + 1) * own, high * record, high * own
        drag = read_lanes(address, (n + 1) * record + DRAG)
        first, behind = places(modal, n)
        at = first + high * row % (behind - first)
        bar = begin(bars, there, at)
        pull = read_lanes(address, here + entries + MOBILITY) * bar
        upper_rate = upper_drift = splat(0.0)
        if high < n:
            upper_rate, upper_drift = read_lanes(bars, end + left), read_lanes(bars, end + left + 1)
        for i in range(high, high - size, -1):
            if 0 < k <= width:
                prefetch(ahead, (i - 1) * width + k - 1)
            lower, under = here - record, there - own
            below = (at if at > first else behind) - row
            bar_lower = begin(bars, under, below)
            pull_lower = read_lanes(address, lower + entries + MOBILITY) * bar_lower
            force = pull_lower - pull
            write_lanes(bars, at + forces + k, force)
            spring = Spring(address, here + length, length, here + constants)
            of_spring = Spring(bars, at + length, length, there + own_constants)
            if kinks:
                has_kink = read_number(address, (here + entries + HAS_KINK) * LANES) > 0.0
                of_rate, of_z = (there + rates, there + zs) if has_kink else (0, there + own_entries + Z_END)
                if is_last:
                    z_bar = read_lanes(bars, there + zs + 1 if has_kink else there + own_entries + Z_END)
                    write_lanes(bars, at + zs + 1, z_bar * share)
            drift_bar, rate_bar, z_bar = expand(spring, of_spring, k, force)
            rate_bar = rate_bar + read_lanes(address, here + entries + DASHPOT) * force
            if kinks:
                rate_bar = rate_bar + read_lanes(bars, of_rate)
                z_bar = (z_bar + read_lanes(bars, of_z)) * last
                write_lanes(bars, there + own_entries + Z_END if k == 0 else at + zs, z_bar)
            v, u = read_lanes(bars, there + own_entries + V_END), read_lanes(bars, there + own_entries + U)
            own_v = v + share * u if is_last else read_lanes(bars, at + k)
            own_v = own_v + (rate_bar - upper_rate - drag * bar)
            by_drift = (drift_bar - upper_drift) * last
            if k == 0:
                write_lanes(bars, there + own_entries + V_END, own_v)
                write_lanes(bars, there + own_entries + U, u + by_drift + read_lanes(bars, there + OF_U))
            elif k == 1:
                write_lanes(bars, at + 1, own_v + read_lanes(bars, there + 1))
                write_lanes(bars, at, v + u + by_drift + read_lanes(bars, there))
            else:
                write_lanes(bars, at + k, own_v)
                write_lanes(bars, at + k - 1, v + last * u + by_drift)
            upper_rate, upper_drift = rate_bar, drift_bar
            bar, pull, here, there, at = bar_lower, pull_lower, lower, under, below
        write_lanes(bars, end + left, upper_rate)
        write_lanes(bars, end + left + 1, upper_drift)
        if modal != 0:
            undamp(bars, modal, n)
        if rest is not None:
            top = high + 1 if high < n else n
            rest(address, bars, modal, n, ahead, top, size - 1 + top - high if size < high else top)

    return order


@cache
def sums_of(series):
    """Return the function that adds to the bars of masses and springs what they get from all orders."""
    length, record, entries, constants = layout_of(series)
    _, own, own_entries, own_constants = layout_of(bars_of(series))
    order, sums, places = series.order, unrolled(series.adjoint.sums), places_of(series)
    row, forces = ring_of(series).width, ring_of(series).width - length
    kinks, rates, load_at = series.branch is not None, (1 + RATE) * length, load_of(series)

    @jit
    def add_sums(address, bars, modal, n, high, size):
        end, total = (n + 1) * record, splat(0.0)
        drag, load = read_lanes(address, end + DRAG), read_lanes(address, end + load_at)
        push = 0.5 * read_lanes(address, end + load_at + 1)
        curved = read_number(address, (end + load_at + CURVED) * LANES) > 0.0
        first, behind = places(modal, n)
        at = first + (high - size) * row % (behind - first)
        for i in range(high - size + 1, high + 1):
            here, there, lower = i * record, i * own, (i - 1) * record
            at = at + row if at + row < behind else first
            v = read_lanes(address, here)
            by_mass = by_drag = by_dashpot = splat(0.0)
            for k in range(order):
                bar, force = read_lanes(bars, at + k + 1), read_lanes(bars, at + forces + k)
                rate = read_lanes(address, here + rates + k) if kinks else v - read_lanes(address, lower + k)
                by_dashpot = by_dashpot + force * rate
                by_drag = by_drag + (1.0 / (k + 1)) * bar * v
                v = read_lanes(address, here + k + 1)
                by_mass = by_mass + bar * v
            of_loads = read_lanes(bars, at + 1) * load + read_lanes(bars, at + 2) * push
            if curved:
                for k in range(2, min(order, DEGREE + 1)):
                    share = read_lanes(address, end + load_at + k) * (1.0 / (k + 1))
                    of_loads = of_loads + read_lanes(bars, at + k + 1) * share
            by_mass = by_mass + drag * by_drag + of_loads
            total = total - by_drag
            drift = read_lanes(address, here + entries + U) - read_lanes(address, lower + entries + U)
            spring = Spring(address, here + length, length, here + constants)
            of_spring = Spring(bars, at + length, length, there + own_constants)
            loading = sign = splat(0.0)
            if kinks:
                sign = read_lanes(address, here + entries + Z_SIGN)
                loading = read_lanes(address, here + entries + RATE_SIGN) * sign
            sums(spring, of_spring, drift, loading, sign)
            add_lanes(bars, there + own_entries + MOBILITY, by_mass)
            add_lanes(bars, there + own_entries + DASHPOT, by_dashpot)
        add_lanes(bars, (n + 1) * own + DRAG, total)

    return add_sums
