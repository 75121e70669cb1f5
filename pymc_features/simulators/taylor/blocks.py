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
from pymc_features.simulators.taylor.tape import tape_of

BLOCK = 8  # springs, whose coefficients fill half of a first cache of 32 KB
SHORT = 16  # springs of a chain that is one block: those of two would be read as often


@cache
def series_of(series, repeats):
    """Return the function that expands all series of a step, and sums them up.

    One that `repeats` a step takes its beginning from a tape. It leaves the displacements there, and sums up
    what the search for kinks needs.

    It returns the number of pairs with kinks that wait in the batch.
    """
    first, others, order = orders_from(series, 0), orders_from(series, 1), series.order
    finish, kinks, restore = finish_of(series, not repeats), series.branch is not None, tape_of(series)[1]
    search = search_of(series) if kinks else None

    @jit
    def expand(group, begun, batch, trace):
        """`begun` tells whether order 0 is done; in a step that is repeated: the address of its beginning."""
        address, _, modal, n = group
        largest = n if modal != 0 or n <= SHORT else BLOCK
        high, count = n, 0
        while high > 0:
            size = largest if high > largest else high
            if repeats:  # and the spring below as well
                top = high if high == n else high - 1
                restore(group, begun, top, size + top - high + (1 if size < high else 0))
            if repeats or not begun:
                first(address, modal, n, high, size)
            top = high + 1 if high + 1 < n else n
            others(address, modal, n, top, size - 1 + top - high if size < high else top)
            if kinks or not repeats:
                top = high + order if high + order < n else n
                finish(address, n, top, size - order + top - high if size < high else top)
            if kinks:
                top = high + order + 1 if high + order + 1 < n else n
                own = size - order - 1 + top - high if size < high else top
                count = search(address, top, own, batch, count, trace)
            high -= size
        return count

    return expand
