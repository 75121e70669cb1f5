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
        largest = n if modal != 0 or n <= SHORT else BLOCK
        high, count = n, 0
        while high > 0:
            size = largest if high > largest else high
            if not has_begun:
                first(address, modal, n, load, high, size)
            top = high + 1 if high + 1 < n else n
            others(address, modal, n, push, top, size - 1 + top - high if size < high else top)
            if ends:
                top = high + order if high + order < n else n
                finish(address, n, top, size - order + top - high if size < high else top)
            if kinks:
                top = high + order + 1 if high + order + 1 < n else n
                own = size - order - 1 + top - high if size < high else top
                count = search(address, top, own, batch, count, trace)
            high -= size
        return count

    return expand
