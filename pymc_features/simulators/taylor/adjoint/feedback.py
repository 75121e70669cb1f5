"""What the kinks of a step change in the chain, in reverse (`feedback.py`)."""

from functools import cache

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number, write_lanes
from pymc_features.simulators.taylor.adjoint.orders import bars_of
from pymc_features.simulators.taylor.feedback import damping_share
from pymc_features.simulators.taylor.layout import (
    CHANGE,
    DASHPOT,
    DRAG,
    HAS_KINK,
    MOBILITY,
    RATE_SIGN,
    V_END,
    Z_END,
    Z_SIGN,
    U,
    add_lanes,
    layout_of,
)
from pymc_features.simulators.taylor.series import Spring


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
        up, down = read_lanes(address, at + MOBILITY), read_lanes(address, at + MOBILITY - record)
        v, v_below = read_lanes(bars, there + V_END), read_lanes(bars, there + V_END - own)
        u, u_below = read_lanes(bars, there + U), read_lanes(bars, there + U - own)
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
            read_lanes(address, kink + 2),
            read_lanes(address, kink + 3),
            read_lanes(address, kink + 4),
        )
        spring = Spring(address, here + length, length, here + constants)
        of_spring = Spring(bars, there + length, length, there + own_constants)
        rate_sign, z_sign = read_lanes(address, at + RATE_SIGN), read_lanes(address, at + Z_SIGN)
        stiffness, z_by_drift, _ = tangent(spring, z)
        dashpot = read_lanes(address, at + DASHPOT)
        z_bar = read_lanes(bars, there + own_entries + Z_END)
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
        write_lanes(bars, there + own_entries + Z_END, z_bar + of_z)
        return of_share, by_drift * j3

    @jit
    def undamp(address, bars, modals, n, i, of_drifts):
        """Reverse of `damp`, and of its share in drifts of the springs from i + 1 down to i - 1."""
        modal, modal_bars = modals
        at, there = i * record + entries, i * own + own_entries
        up, down = read_lanes(address, at + MOBILITY), read_lanes(address, at + MOBILITY - record)
        j2, j3 = read_lanes(address, at + CHANGE + 2), read_lanes(address, at + CHANGE + 3)
        of_j2 = of_j3 = of_up = of_down = splat(0.0)
        for j in range(1, n + 1):
            mass, to = j * own + own_entries, (j - 1) * n + i - 1
            v, u = read_lanes(bars, mass + V_END), read_lanes(bars, mass + U)
            share, bar = damping_share(modal, n, j, i, up, down), v * j2 + u * j3
            of_j2, of_j3 = of_j2 + share * v, of_j3 + share * u
            for c in range(3):  # the drift of spring i + 1 - c is that of its mass less that below
                if j == i + 1 - c:
                    bar = bar + of_drifts[c]
                elif j == i - c:
                    bar = bar - of_drifts[c]
            add_lanes(modal_bars, to, up * bar)
            of_up = of_up + read_lanes(modal, to) * bar
            if i > 1:
                add_lanes(modal_bars, to - 1, 0.0 - down * bar)
                of_down = of_down + read_lanes(modal, to - 1) * bar
        add_lanes(bars, there + MOBILITY, up * of_up)
        add_lanes(bars, there + MOBILITY - own, 0.0 - down * of_down)
        add_lanes(bars, there + CHANGE + 2, of_j2)
        add_lanes(bars, there + CHANGE + 3, of_j3)

    @jit
    def unapply(address, bars, modals, n, before):
        """Carry the bars of a step's end back to those before the changes; `before` is that of `apply`.

        `modals` are the addresses of H M^-1 C and its bars.
        """
        drag, modal = read_lanes(address, (n + 1) * record + DRAG), modals[0]
        for i in range(n, 0, -1):
            at, there = i * record + entries, i * own + own_entries
            if read_number(address, (at + HAS_KINK) * LANES) > 0.0:
                up, down = read_lanes(address, at + MOBILITY), read_lanes(address, at + MOBILITY - record)
                j1, j2 = read_lanes(address, at + CHANGE + 1), read_lanes(address, at + CHANGE + 2)
                for c in range(CHANGE, CHANGE + 5):
                    write_lanes(bars, there + c, splat(0.0))
                zero = splat(0.0)
                of_up, of_down = (zero, zero), (zero, zero)
                damped = damping_share(modal, n, i - 1, i, up, down)
                damped_above = damping_share(modal, n, i, i, up, down)
                if i < n:
                    shares = up, damping_share(modal, n, i + 1, i, up, down) - damped_above
                    of_up = unrespond(address, bars, i + 1, i, shares, read_lanes(before, 3 * i + 2))
                shares = 0.0 - (up + down), damped_above - damped
                of_own = unrespond(address, bars, i, i, shares, read_lanes(before, 3 * i + 1))
                if i > 1:
                    shares = down, damped - damping_share(modal, n, i - 2, i, up, down)
                    of_down = unrespond(address, bars, i - 1, i, shares, read_lanes(before, 3 * i))
                if modal != 0:
                    undamp(address, bars, modals, n, i, (of_up[1], of_own[1], of_down[1]))
                of_1, of_2 = unpush(address, bars, i, j1 - drag * j2, j2)
                add_lanes(bars, there + MOBILITY, up * (of_up[0] - of_own[0]))
                add_lanes(bars, there + MOBILITY - own, down * (of_down[0] - of_own[0]))
                add_lanes(bars, there + CHANGE + 1, of_1)
                add_lanes(bars, there + CHANGE + 2, of_2 - drag * of_1)
                add_lanes(bars, (n + 1) * own + DRAG, 0.0 - j2 * of_1)
                write_lanes(bars, there + CHANGE, read_lanes(bars, there + Z_END))

    return unapply
