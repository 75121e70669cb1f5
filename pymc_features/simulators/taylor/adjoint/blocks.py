"""A step of a chain in reverse, one block of springs after the other, as in `taylor/blocks.py`."""

from functools import cache

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.taylor.adjoint.orders import BLOCK, reverse_from, sums_of


@cache
def reverse_of(series):
    """Return the function that carries bars back over all orders of a step."""
    order, others, first = series.order, reverse_from(series, series.order - 1), reverse_from(series, 0)
    add_sums = sums_of(series)

    @jit
    def reverse(address, bars, modal, n, ahead):
        largest = n if modal != 0 else BLOCK
        high = n
        while high > 0:
            size = largest if high > largest else high
            others(address, bars, modal, n, ahead, high, size)
            top = high + order - 1 if high + order - 1 < n else n
            own = size - order + 1 + top - high if size < high else top
            first(address, bars, modal, n, ahead, top, own)
            add_sums(address, bars, modal, n, top, own)
            high -= size

    return reverse
