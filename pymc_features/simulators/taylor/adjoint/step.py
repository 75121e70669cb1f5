"""A step of a group of chains in reverse: it is repeated, and bars at its end become those at its start."""

from functools import cache

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.compiled.vector import LANES, splat
from pymc_features.simulators.compiled.vector_memory import read_lanes, read_number, write_lanes, write_number
from pymc_features.simulators.taylor.adjoint.blocks import reverse_of
from pymc_features.simulators.taylor.adjoint.feedback import feedback_adjoint
from pymc_features.simulators.taylor.adjoint.kinks import turns_adjoint
from pymc_features.simulators.taylor.adjoint.orders import bars_of, damping_bars
from pymc_features.simulators.taylor.blocks import series_of
from pymc_features.simulators.taylor.feedback import feedback_of
from pymc_features.simulators.taylor.kinks import turn_of
from pymc_features.simulators.taylor.layout import HAS_KINK, RATE_SIGN, Z_END, Z_SIGN, layout_of
from pymc_features.simulators.taylor.series import RATE, Spring, Z
from pymc_features.simulators.taylor.tape import signs_of, width_of


@cache
def branches_of(series):
    """Return the functions that begin the reverse of a step with kinks, and bring back its branches."""
    length, record, entries, constants = layout_of(series)
    _, own, own_entries, _ = layout_of(bars_of(series))
    width = width_of(series)
    rates, zs = (1 + RATE) * length, (1 + Z) * length
    branch = jit(series.branch)

    @jit
    def has_kink(address, i):
        return read_number(address, (i * record + entries + HAS_KINK) * LANES) > 0.0

    @jit
    def spread(address, bars, n):
        """Give the coefficients of springs with kinks the bars that those of others begin with."""
        for i in range(1, n + 1):
            if has_kink(address, i):
                here = i * own
                z = read_lanes(bars, here + own_entries + Z_END)
                for k in range(length):
                    write_lanes(bars, here + zs + k, z)
                    write_lanes(bars, here + rates + k, splat(0.0))

    @jit
    def restore_branches(group, state):
        """Bring back the branches of springs that had kinks."""
        address, n = group.address, group.n
        for i in range(1, n + 1):
            if has_kink(address, i):
                here = i * record
                rate_sign, z_sign = signs_of(read_lanes(state, (i - 1) * width + 3))
                write_lanes(address, here + entries + RATE_SIGN, rate_sign)
                write_lanes(address, here + entries + Z_SIGN, z_sign)
                branch(Spring(address, here + length, length, here + constants), rate_sign * z_sign, z_sign)

    return spread, restore_branches


@cache
def step_adjoint(series):
    """Return functions that carry bars back over a step that is repeated, or over one that is not taken."""
    width, kinks = width_of(series), series.branch is not None
    expand, reverse, add_damping = series_of(series, True), reverse_of(series), damping_bars(series)
    if kinks:
        turn, unturn, apply = turn_of(series), turns_adjoint(series), feedback_of(series)
        unapply = feedback_adjoint(series)
        spread, restore_branches = branches_of(series)

    @jit
    def reverse_step(group, memory, states, slot):
        """Repeat the step that begins in a slot, and carry bars back over it."""
        address, _, modal, n = group
        bars = memory.bars
        if kinks:
            write_number(memory.trace, 0, 0.0)
        state = states + 8 * LANES * (slot * n * width)
        count = expand(group, state, memory.batch, memory.trace)
        if kinks:
            if count > 0:
                turn(memory.batch, count, memory.trace)
            apply(address, modal, n, memory.before)
            unapply(address, bars, (modal, memory.modal), n, memory.before)
            spread(address, bars, n)
            unturn(bars, memory.kinks, memory.trace)
            restore_branches(group, state)
        ahead = states + 8 * LANES * (max(slot - 1, 0) * n * width)
        reverse(address, bars, modal, n, ahead)
        if modal != 0:
            add_damping(address, bars, memory.modal, n)

    @jit
    def reverse_end(group, memory):
        """Carry bars back over the first order of a step behind the end of the march."""
        address, _, modal, n = group
        reverse(address, memory.bars, modal, n, address)
        if modal != 0:
            add_damping(address, memory.bars, memory.modal, n)

    return reverse_step, reverse_end
