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

What the kinks of a step change in the chain, in reverse (`feedback.py`).
"""

from functools import cache
from typing import NamedTuple

from pymc_features.simulators.compiled.jit import jit, unrolled
from pymc_features.simulators.numbers.vectors import LANES, load, prefetch, read_number, splat, store
from pymc_features.simulators.taylor.feedback import damping_share
from pymc_features.simulators.taylor.ground import DEGREE
from pymc_features.simulators.taylor.layout import (
    CHANGE,
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
    width_of,
)
from pymc_features.simulators.taylor.series import RATE, Spring, Z

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
                total = total + load(modal, i * n + j) * load(bars, first + (i + 1) * width + k + 1)
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
                    total = total + share * (load(address, v + k) * load(bars, bar + k + 1))
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
            return share * load(bars, at + k + 1)
        v, u = load(bars, there + own_entries + V_END), load(bars, there + own_entries + U)
        bar = v + splat(1.0 / (k + 2)) * u
        store(bars, at + k + 1, bar)
        return share * bar

    @jit
    def order(address, bars, modal, n, ahead, high, size):
        end, here, there = (n + 1) * own, high * record, high * own
        drag = load(address, (n + 1) * record + DRAG)
        first, behind = places(modal, n)
        at = first + high * row % (behind - first)
        bar = begin(bars, there, at)
        pull = load(address, here + entries + MOBILITY) * bar
        upper_rate = upper_drift = splat(0.0)
        if high < n:
            upper_rate, upper_drift = load(bars, end + left), load(bars, end + left + 1)
        for i in range(high, high - size, -1):
            if 0 < k <= width:
                prefetch(ahead, (i - 1) * width + k - 1)
            lower, under = here - record, there - own
            below = (at if at > first else behind) - row
            bar_lower = begin(bars, under, below)
            pull_lower = load(address, lower + entries + MOBILITY) * bar_lower
            force = pull_lower - pull
            store(bars, at + forces + k, force)
            spring = Spring(address, here + length, length, here + constants)
            of_spring = Spring(bars, at + length, length, there + own_constants)
            if kinks:
                has_kink = read_number(address, (here + entries + HAS_KINK) * LANES) > 0.0
                of_rate, of_z = (there + rates, there + zs) if has_kink else (0, there + own_entries + Z_END)
                if is_last:
                    z_bar = load(bars, there + zs + 1 if has_kink else there + own_entries + Z_END)
                    store(bars, at + zs + 1, z_bar * share)
            drift_bar, rate_bar, z_bar = expand(spring, of_spring, k, force)
            rate_bar = rate_bar + load(address, here + entries + DASHPOT) * force
            if kinks:
                rate_bar = rate_bar + load(bars, of_rate)
                z_bar = (z_bar + load(bars, of_z)) * last
                store(bars, there + own_entries + Z_END if k == 0 else at + zs, z_bar)
            v, u = load(bars, there + own_entries + V_END), load(bars, there + own_entries + U)
            own_v = v + share * u if is_last else load(bars, at + k)
            own_v = own_v + (rate_bar - upper_rate - drag * bar)
            by_drift = (drift_bar - upper_drift) * last
            if k == 0:
                store(bars, there + own_entries + V_END, own_v)
                store(bars, there + own_entries + U, u + by_drift + load(bars, there + OF_U))
            elif k == 1:
                store(bars, at + 1, own_v + load(bars, there + 1))
                store(bars, at, v + u + by_drift + load(bars, there))
            else:
                store(bars, at + k, own_v)
                store(bars, at + k - 1, v + last * u + by_drift)
            upper_rate, upper_drift = rate_bar, drift_bar
            bar, pull, here, there, at = bar_lower, pull_lower, lower, under, below
        store(bars, end + left, upper_rate)
        store(bars, end + left + 1, upper_drift)
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
        drag, ground = load(address, end + DRAG), load(address, end + load_at)
        push = 0.5 * load(address, end + load_at + 1)
        curved = read_number(address, (end + load_at + CURVED) * LANES) > 0.0
        first, behind = places(modal, n)
        at = first + (high - size) * row % (behind - first)
        for i in range(high - size + 1, high + 1):
            here, there, lower = i * record, i * own, (i - 1) * record
            at = at + row if at + row < behind else first
            v = load(address, here)
            by_mass = by_drag = by_dashpot = splat(0.0)
            for k in range(order):
                bar, force = load(bars, at + k + 1), load(bars, at + forces + k)
                rate = load(address, here + rates + k) if kinks else v - load(address, lower + k)
                by_dashpot = by_dashpot + force * rate
                by_drag = by_drag + (1.0 / (k + 1)) * bar * v
                v = load(address, here + k + 1)
                by_mass = by_mass + bar * v
            of_loads = load(bars, at + 1) * ground + load(bars, at + 2) * push
            if curved:
                for k in range(2, min(order, DEGREE + 1)):
                    share = load(address, end + load_at + k) * (1.0 / (k + 1))
                    of_loads = of_loads + load(bars, at + k + 1) * share
            by_mass = by_mass + drag * by_drag + of_loads
            total = total - by_drag
            drift = load(address, here + entries + U) - load(address, lower + entries + U)
            spring = Spring(address, here + length, length, here + constants)
            of_spring = Spring(bars, at + length, length, there + own_constants)
            loading = sign = splat(0.0)
            if kinks:
                sign = load(address, here + entries + Z_SIGN)
                loading = load(address, here + entries + RATE_SIGN) * sign
            sums(spring, of_spring, drift, loading, sign)
            add_lanes(bars, there + own_entries + MOBILITY, by_mass)
            add_lanes(bars, there + own_entries + DASHPOT, by_dashpot)
        add_lanes(bars, (n + 1) * own + DRAG, total)

    return add_sums


@cache
def feedback_adjoint(series):
    """Return the function that carries bars back through the changes of all kinks of a step."""
    length, record, entries, constants = layout_of(series)
    _, own, own_entries, own_constants = layout_of(bars_of(series))
    tangent, untangent = jit(series.tangent), jit(series.adjoint.tangent)

    @jit
    def unpush(address, bars, i, force_1, force_2):
        """Bars of both integrals of a force that pushes the ends of spring i; add to those of the masses."""
        at, there = i * record + entries, i * own + own_entries
        up, down = load(address, at + MOBILITY), load(address, at + MOBILITY - record)
        v, v_below = load(bars, there + V_END), load(bars, there + V_END - own)
        u, u_below = load(bars, there + U), load(bars, there + U - own)
        of_up, of_down = up * (force_1 * v + force_2 * u), down * (force_1 * v_below + force_2 * u_below)
        add_lanes(bars, there + MOBILITY, 0.0 - of_up)
        add_lanes(bars, there + MOBILITY - own, of_down)
        return down * v_below - up * v, down * u_below - up * u

    @jit
    def unrespond(address, bars, s, i, shares, z):
        """Reverse of the response of spring s to the kink of spring i; returns the bars of its shares."""
        share, damped = shares
        here, there, kink = s * record, s * own, i * record + entries + CHANGE
        at, of_kink = here + entries, i * own + own_entries + CHANGE
        j2, j3, j4 = (
            load(address, kink + 2),
            load(address, kink + 3),
            load(address, kink + 4),
        )
        spring = Spring(address, here + length, length, here + constants)
        of_spring = Spring(bars, there + length, length, there + own_constants)
        rate_sign, z_sign = load(address, at + RATE_SIGN), load(address, at + Z_SIGN)
        stiffness, z_by_drift, _ = tangent(spring, z)
        dashpot = load(address, at + DASHPOT)
        z_bar = load(bars, there + own_entries + Z_END)
        force_1, force_2 = stiffness * j3 + dashpot * j2, stiffness * j4 + dashpot * j3
        of_1, of_2 = unpush(address, bars, s, share * force_1, share * force_2)
        of_share = of_1 * force_1 + of_2 * force_2 + z_bar * (z_by_drift * j2)
        of_1, of_2 = share * of_1, share * of_2
        add_lanes(bars, there + own_entries + DASHPOT, of_1 * j2 + of_2 * j3)
        by_drift = z_bar * z_by_drift
        add_lanes(bars, of_kink + 2, of_1 * dashpot + by_drift * share)
        add_lanes(bars, of_kink + 3, of_1 * stiffness + of_2 * dashpot + by_drift * damped)
        add_lanes(bars, of_kink + 4, of_2 * stiffness)
        of_stiffness = of_1 * j3 + of_2 * j4
        of_tangents = of_stiffness, z_bar * (share * j2 + damped * j3), splat(0.0)
        of_z = untangent(spring, of_spring, z, of_tangents, rate_sign * z_sign, z_sign)
        store(bars, there + own_entries + Z_END, z_bar + of_z)
        return of_share, by_drift * j3

    @jit
    def undamp(address, bars, modals, n, i, of_drifts):
        """Reverse of `damp`, and of its share in drifts of the springs from i + 1 down to i - 1."""
        modal, modal_bars = modals
        at, there = i * record + entries, i * own + own_entries
        up, down = load(address, at + MOBILITY), load(address, at + MOBILITY - record)
        j2, j3 = load(address, at + CHANGE + 2), load(address, at + CHANGE + 3)
        of_j2 = of_j3 = of_up = of_down = splat(0.0)
        for j in range(1, n + 1):
            mass, to = j * own + own_entries, (j - 1) * n + i - 1
            v, u = load(bars, mass + V_END), load(bars, mass + U)
            share, bar = damping_share(modal, n, j, i, up, down), v * j2 + u * j3
            of_j2, of_j3 = of_j2 + share * v, of_j3 + share * u
            for c in range(3):  # the drift of spring i + 1 - c is that of its mass less that below
                if j == i + 1 - c:
                    bar = bar + of_drifts[c]
                elif j == i - c:
                    bar = bar - of_drifts[c]
            add_lanes(modal_bars, to, up * bar)
            of_up = of_up + load(modal, to) * bar
            if i > 1:
                add_lanes(modal_bars, to - 1, 0.0 - down * bar)
                of_down = of_down + load(modal, to - 1) * bar
        add_lanes(bars, there + MOBILITY, up * of_up)
        add_lanes(bars, there + MOBILITY - own, 0.0 - down * of_down)
        add_lanes(bars, there + CHANGE + 2, of_j2)
        add_lanes(bars, there + CHANGE + 3, of_j3)

    @jit
    def unapply(address, bars, modals, n, before):
        """Carry the bars of a step's end back to those before the changes; `before` is that of `apply`.

        `modals` are the addresses of H M^-1 C and its bars.
        """
        drag, modal = load(address, (n + 1) * record + DRAG), modals[0]
        for i in range(n, 0, -1):
            at, there = i * record + entries, i * own + own_entries
            if read_number(address, (at + HAS_KINK) * LANES) > 0.0:
                up, down = load(address, at + MOBILITY), load(address, at + MOBILITY - record)
                j1, j2 = load(address, at + CHANGE + 1), load(address, at + CHANGE + 2)
                for c in range(CHANGE, CHANGE + 5):
                    store(bars, there + c, splat(0.0))
                zero = splat(0.0)
                of_up, of_down = (zero, zero), (zero, zero)
                damped = damping_share(modal, n, i - 1, i, up, down)
                damped_above = damping_share(modal, n, i, i, up, down)
                if i < n:
                    shares = up, damping_share(modal, n, i + 1, i, up, down) - damped_above
                    of_up = unrespond(address, bars, i + 1, i, shares, load(before, 3 * i + 2))
                shares = 0.0 - (up + down), damped_above - damped
                of_own = unrespond(address, bars, i, i, shares, load(before, 3 * i + 1))
                if i > 1:
                    shares = down, damped - damping_share(modal, n, i - 2, i, up, down)
                    of_down = unrespond(address, bars, i - 1, i, shares, load(before, 3 * i))
                if modal != 0:
                    undamp(address, bars, modals, n, i, (of_up[1], of_own[1], of_down[1]))
                of_1, of_2 = unpush(address, bars, i, j1 - drag * j2, j2)
                add_lanes(bars, there + MOBILITY, up * (of_up[0] - of_own[0]))
                add_lanes(bars, there + MOBILITY - own, down * (of_down[0] - of_own[0]))
                add_lanes(bars, there + CHANGE + 1, of_1)
                add_lanes(bars, there + CHANGE + 2, of_2 - drag * of_1)
                add_lanes(bars, (n + 1) * own + DRAG, 0.0 - j2 * of_1)
                store(bars, there + CHANGE, load(bars, there + Z_END))

    return unapply
