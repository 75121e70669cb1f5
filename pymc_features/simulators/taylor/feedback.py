"""What the kinks of a step change in the chain: the masses they push, and the springs beside them.

These follow on the branch behind their own last kink. Where most of that was before it, z is wrong by a part
of what it follows; the less so the smaller z, for the branches part as |z|^n does.

The spring with the kink follows it once. What it would follow of the force of that is left out: with the sum
s of the mobilities of its ends, its tangent k and its dashpot c,

    dz = dz/dd s^2 (k J4 + c J3),

small but for stiff springs that have flowed in long steps. Steps with errors of either kind beyond
`LARGEST_KINK_ERROR` are taken once more, shorter (`march.py`).
"""

from functools import cache

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import larger, magnitude, where_less
from pymc_features.simulators.numbers.vectors import LANES, load, read_number, splat, store
from pymc_features.simulators.taylor.layout import (
    CHANGE,
    DASHPOT,
    DRAG,
    HAS_KINK,
    KINK_ERROR,
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

LEFT_OUT = 0.1  # weight of what a spring does not follow of its own kink: it is known, the others are bounds


@jit
def damping_share(modal, n, j, i, up, down):
    """What damping by modal ratios gives back of the velocity that a force in spring i takes from mass j.

    Per force, integrated once more: -(H M^-1 C)_ji (-up) - (H M^-1 C)_j,i-1 down.
    """
    share = splat(0.0)
    if modal != 0 and j > 0:
        share = load(modal, (j - 1) * n + i - 1) * up
        if i > 1:
            share = share - load(modal, (j - 1) * n + i - 2) * down
    return share


@cache
def feedback_of(series):
    """Return the function that applies the changes."""
    length, record, entries, constants = layout_of(series)
    branch, tangent = jit(series.branch), jit(series.tangent)

    @jit
    def push(address, at, force_1, force_2):
        """Change velocity and displacement of the masses at a spring's ends, and let its force follow."""
        up, down = load(address, at + MOBILITY), load(address, at + MOBILITY - record)
        add_lanes(address, at + V_END, (0.0 - up) * force_1)
        add_lanes(address, at + U, (0.0 - up) * force_2)
        add_lanes(address, at + V_END - record, down * force_1)
        add_lanes(address, at + U - record, down * force_2)

    @jit
    def estimate_error(address, at, n, effect):
        """Keep what a spring with a kink of its own follows, times z, if it is the largest of its chain."""
        if read_number(address, (at + HAS_KINK) * LANES) > 0.0:
            error, own = (n + 1) * record + KINK_ERROR, magnitude(load(address, at + CHANGE))
            effect = where_less(splat(0.0), own, magnitude(effect), splat(0.0))
            store(address, error, larger(load(address, error), effect))

    @jit
    def damp(address, modal, n, i, up, down):
        """Damp what the force of the kink of spring i moves, in all masses."""
        kink = i * record + entries + CHANGE
        j2, j3 = load(address, kink + 2), load(address, kink + 3)
        for j in range(1, n + 1):
            share, at = damping_share(modal, n, j, i, up, down), j * record + entries
            add_lanes(address, at + V_END, share * j2)
            add_lanes(address, at + U, share * j3)

    @jit
    def respond(address, n, here, shares, kink, before):
        """Let a spring follow a drift: shares of the force of a kink, integrated twice and three times.

        Returns z before that, and what it would follow of its own push.
        """
        share, damped = shares
        at = here + entries
        j2 = load(address, kink + CHANGE + 2)
        j3, j4 = load(address, kink + CHANGE + 3), load(address, kink + CHANGE + 4)
        spring = Spring(address, here + length, length, here + constants)
        z, rest = load(address, at + Z_END), splat(0.0)
        stiffness, z_by_drift, _ = tangent(spring, z)
        if before is None:
            dashpot = load(address, at + DASHPOT)
            force_1, force_2 = stiffness * j3 + dashpot * j2, stiffness * j4 + dashpot * j3
            push(address, at, share * force_1, share * force_2)
            rest = z_by_drift * (share * share) * force_2
        change = z_by_drift * (share * j2 + damped * j3)
        store(address, at + Z_END, z + change)
        if before is None and at != kink:
            estimate_error(address, at, n, change * z)
        return z, rest

    @jit
    def apply(address, modal, n, before):
        """Add the changes of all kinks of the step.

        Unless `before` is None z alone changes, and what that of the springs that follow was is written
        there, three vectors for each kink.
        """
        drag, worst = load(address, (n + 1) * record + DRAG), splat(0.0)
        for i in range(1, n + 1):
            here = i * record
            at = here + entries
            if read_number(address, (at + HAS_KINK) * LANES) > 0.0:  # the branch behind its kinks
                rate_sign, z_sign = load(address, at + RATE_SIGN), load(address, at + Z_SIGN)
                branch(Spring(address, here + length, length, here + constants), rate_sign * z_sign, z_sign)
        for i in range(1, n + 1):
            here = i * record
            at = here + entries
            if read_number(address, (at + HAS_KINK) * LANES) > 0.0:
                up, down = load(address, at + MOBILITY), load(address, at + MOBILITY - record)
                j1, j2 = load(address, at + CHANGE + 1), load(address, at + CHANGE + 2)
                add_lanes(address, at + Z_END, load(address, at + CHANGE))
                if before is None:
                    push(address, at, j1 - drag * j2, j2)
                    if modal != 0:
                        damp(address, modal, n, i, up, down)
                below = above = splat(0.0)
                damped = damping_share(modal, n, i - 1, i, up, down)
                damped_above = damping_share(modal, n, i, i, up, down)
                if i > 1:
                    shares = down, damped - damping_share(modal, n, i - 2, i, up, down)
                    below, _ = respond(address, n, here - record, shares, at, before)
                shares = 0.0 - (up + down), damped_above - damped
                own, rest = respond(address, n, here, shares, at, before)
                worst = larger(worst, magnitude(rest))
                if i < n:
                    shares = up, damping_share(modal, n, i + 1, i, up, down) - damped_above
                    above, _ = respond(address, n, here + record, shares, at, before)
                if before is not None:
                    store(before, 3 * i, below)
                    store(before, 3 * i + 1, own)
                    store(before, 3 * i + 2, above)
        if before is None:
            error = (n + 1) * record + KINK_ERROR
            store(address, error, larger(load(address, error), LEFT_OUT * worst))

    return apply
