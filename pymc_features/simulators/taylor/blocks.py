"""A step of a chain, one block of springs after the other, from the highest down.

The coefficients of thirty masses do not fit into the first cache. Order k of a spring needs order k - 1 of it
and of the spring below, so that the orders of a block can follow each other where every one of them stays one
spring behind the order before it; so do the sums at the end of the step, and the search for kinks. Damping by
modal ratios couples all masses in every order: then the chain is one block.
"""

from functools import cache

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.taylor.orders import finish_of, orders_from
from pymc_features.simulators.taylor.search import search_of

BLOCK = 8  # springs, whose coefficients fill half of a first cache of 32 KB
SHORT = 16  # springs of a chain that is one block: those of two would be read as often


@jit
def behind(high, low, n, lag):
    """Highest and lowest spring of a block for those that stay behind by `lag` springs."""
    return min(high + lag, n), low + lag if low > 1 else 1


@cache
def series_of(series, ends):
    """Return the function that expands all series of a step, and where it `ends` sums them up.

    It returns the number of pairs with kinks that wait in the batch.
    """
    first, others, order = orders_from(series, 0), orders_from(series, 1), series.order
    finish, kinks = finish_of(series), series.branch is not None
    search = search_of(series) if kinks else None

    @jit
    def expand(group, load, push, has_begun, batch, trace):
        """`load` and `push` are H^2 times the ground acceleration at the beginning, and its change."""
        address, _, modal, n = group
        size = n if modal != 0 or n <= SHORT else BLOCK
        high, count = n, 0
        while high > 0:
            low = high - size + 1 if high > size else 1
            if not has_begun:
                first(address, modal, n, load, high, low)
            top, bottom = behind(high, low, n, 1)
            others(address, modal, n, push, top, bottom)
            if ends:
                top, bottom = behind(high, low, n, order)
                finish(address, n, top, bottom)
            if kinks:
                top, bottom = behind(high, low, n, order + 1)
                count = search(address, (top, bottom), batch, count, trace)
            high = low - 1
        return count

    return expand
