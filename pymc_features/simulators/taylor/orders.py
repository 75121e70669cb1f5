"""The recurrence of the coefficients of a chain, and the sums at the end of a step.

With the coefficients V_i,k of H v_i, R_i,k = V_i,k - V_i-1,k those of the drift rate and D_k = R_k-1 / k
those of the drift,

    V_i,k+1 = [ H^2/m_i (f_i+1,k - f_i,k) - alpha H V_i,k - H^2 g_k ] / (k + 1),

where f includes the dashpot, (beta k_i / H) R_i,k, and g_k are the coefficients of the ground acceleration
over the step (`ground/spans.py`). One function is compiled for each k, a closure, so that its sums are
written out. Each takes a block of `size` springs, from spring `high` down, and the next order stays one
spring behind (`blocks.py`).
"""

from functools import cache

import numpy as np

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import larger, magnitude, where_less
from pymc_features.simulators.numbers.vectors import LANES, load, read_number, splat, store
from pymc_features.simulators.taylor.ground import DEGREE
from pymc_features.simulators.taylor.layout import (
    CURVED,
    DASHPOT,
    DRAG,
    FIRST,
    HARMLESS,
    LAST,
    LAST_Z,
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
from pymc_features.simulators.taylor.series import Spring, Z, write_coefficient

HUGE = 1e250


@cache
def damping_of(record):
    """Return the function that takes H M^-1 C V_k of damping by modal ratios from the coefficients k + 1.

    H M^-1 C lies in the rows of `modal`; `first` is the address of coefficient k in record 0, and `share` is
    -1 / (k + 1).
    """

    @jit
    def damp(first, modal, n, share):
        for i in range(n):
            total = splat(0.0)
            for j in range(n):
                total = total + load(modal, i * n + j) * load(first, (j + 1) * record)
            add_lanes(first, (i + 1) * record + 1, total * share)

    return damp


@cache
def orders_from(series, k):
    """Return the function for coefficients k + 1 of the velocities; for k > 0 for all above as well.

    The function for k = 0 begins the step at the state in the entries.
    """
    length, record, entries, constants = layout_of(series)
    expand, share, last = jit(series.expand), 1.0 / (k + 1), 1.0 / max(k, 1)
    rest = orders_from(series, k + 1) if 0 < k < series.order - 1 else None
    load_at, left = load_of(series), N_CHAIN_ENTRIES + k
    starts, damp = k == 0, damping_of(record)
    begins = starts and series.branch is not None
    branch = jit(series.branch) if begins else None
    v_at = entries + V_END if starts else k

    @jit
    def order(address, modal, n, high, size):
        end, upper = (n + 1) * record, splat(0.0)
        if high < n:
            upper = load(address, end + left)
        drag, here, largest, ground = load(address, end + DRAG), high * record, splat(0.0), splat(0.0)
        if k <= 1:
            ground = load(address, end + load_at + k)
        v = load(address, here + v_at)
        for _ in range(size):
            lower, at = here - record, here + entries
            v_lower = load(address, lower + v_at)
            spring = Spring(address, here + length, length, here + constants)
            if starts:
                drift = load(address, at + U) - load(address, lower + entries + U)
                store(address, here, v)
            else:
                drift = (load(address, here + k - 1) - load(address, lower + k - 1)) * last
            if begins:
                rate_sign, z_sign = load(address, at + RATE_SIGN), load(address, at + Z_SIGN)
                branch(spring, rate_sign * z_sign, z_sign)
                write_coefficient(spring, Z, 0, load(address, at + Z_END))
            rate = v - v_lower
            force = expand(spring, k, drift, rate)
            force = force + load(address, at + DASHPOT) * rate
            pull = load(address, at + MOBILITY) * (upper - force)
            acceleration = share * (pull - drag * v - ground)
            store(address, here + k + 1, acceleration)
            if starts and modal == 0:
                largest = larger(largest, magnitude(acceleration))
            upper, v, here = force, v_lower, lower
        store(address, end + left, upper)
        if 1 < k <= DEGREE and read_number(address, (end + load_at + CURVED) * LANES) > 0.0:
            ground = load(address, end + load_at + k) * share
            for i in range(high - size + 1, high + 1):
                add_lanes(address, i * record + k + 1, 0.0 - ground)
        if modal != 0:
            damp(address + 8 * LANES * k, modal, n, -share)
            if starts:
                for i in range(1, n + 1):
                    largest = larger(largest, magnitude(load(address, i * record + 1)))
        if starts:
            store(address, end + FIRST, larger(load(address, end + FIRST), largest))
        if rest is not None:
            top = high + 1 if high < n else n
            rest(address, modal, n, top, size - 1 + top - high if size < high else top)

    return order


@cache
def finish_of(series, moves):
    """Return the function that sums the series up at the end of a step, all of them or those of H v and z."""
    length, record, entries, _ = layout_of(series)
    order, kinks = series.order, series.branch is not None
    z_first, load_at = (1 + Z) * length, load_of(series) + HARMLESS if order == DEGREE + 1 else 0

    @jit
    def finish(address, n, high, size):
        """Advance H v and z of a block of springs, and where it `moves` u.

        Then the largest last coefficients of each chain are kept as well, without what is no error in them.
        """
        ground = splat(0.0)
        if load_at > 0:
            ground = load(address, (n + 1) * record + load_at)
        largest = largest_z = total = splat(0.0)
        for i in range(high - size + 1, high + 1):
            here = i * record
            v = load(address, here + order)
            largest = larger(largest, magnitude(v + ground))
            u = v * (1.0 / (order + 1))
            for k in range(order - 1, -1, -1):
                c = load(address, here + k)
                v = v + c
                u = u + c * (1.0 / (k + 1))
            total = total + v  # a maximum forgets what is not finite
            at = here + entries
            if moves:
                store(address, at + U, load(address, at + U) + u)
            store(address, at + V_END, v)
            if kinks:
                z = load(address, here + z_first + order)
                largest_z = larger(largest_z, magnitude(z))
                for k in range(order - 1, -1, -1):
                    z = z + load(address, here + z_first + k)
                store(address, at + Z_END, z)
        if moves:
            largest = where_less(magnitude(total), splat(HUGE), largest, splat(np.inf))
            last = (n + 1) * record + LAST
            store(address, last, larger(load(address, last), largest))
        if moves and kinks:
            last = (n + 1) * record + LAST_Z
            store(address, last, larger(load(address, last), largest_z))

    return finish
