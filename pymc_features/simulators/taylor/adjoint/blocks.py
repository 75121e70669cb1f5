"""A step of a chain in reverse, one block of springs after the other, as in `taylor/blocks.py`."""

from functools import cache

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.taylor.adjoint.orders import reverse_from, sums_of

BLOCK = 4  # springs: there is more of each than in `taylor/blocks.py`


@cache
def reverse_of(series):
    """Return the function that carries bars back over all orders of a step, or over order 0 alone."""
    order, others, first, add_sums = (
        series.order,
        reverse_from(series, series.order - 1),
        reverse_from(series, 0),
        sums_of(series),
    )

    @jit
    def reverse(address, bars, modal, n, loads, ahead, first_only, to_first):
        """`loads` are H^2 times the ground acceleration at the beginning of the step, and its change."""
        largest = n if modal != 0 or first_only else BLOCK
        high = n
        while high > 0:
            size = largest if high > largest else high
            if not first_only:
                others(address, bars, modal, n, ahead, high, size)
            if to_first:
                top = high + order - 1 if high + order - 1 < n and not first_only else n
                own = size - order + 1 + top - high if size < high else top
                first(address, bars, modal, n, ahead, top, own)
                add_sums(address, bars, n, loads, top, own)
            high -= size

    return reverse
