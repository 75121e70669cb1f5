"""Cuts of a population into parts."""

PER_PLACE = 2  # parts of what is left, for each place of work: large parts first, small ones at the end


def parts_of(n: int, unit: int, least: int, places: int | None) -> list[tuple[int, int]]:
    """First rows of parts of `n` particles, and the rows after their last ones.

    Parameters
    ----------
    n : int
        Particles.
    unit : int
        A population is cut at multiples of it, and no part is smaller.
    least : int
        Particles of a part that are worth a message.
    places : int or None
        How many parts are in work at once; None where nobody knows, and then all parts are small.

    Notes
    -----
    Guided self-scheduling (Polychronopoulos & Kuck, IEEE Trans. Comput. C-36 (1987), 1425-1439): each part is
    a fixed share of what is left, so that the last ones, for which nobody wants to wait, are small.

    Examples
    --------
    >>> parts_of(100, unit=8, least=10, places=2)
    [(0, 32), (32, 56), (56, 72), (72, 100)]
    >>> parts_of(15, unit=8, least=1, places=2)
    [(0, 15)]
    """
    smallest = -(-max(least, unit) // unit) * unit
    first, parts = 0, []
    while first < n:
        left = n - first
        share = 0 if places is None else left / (PER_PLACE * places)
        size = max(smallest, -(-int(share) // unit) * unit)
        end = n if left - size < smallest else first + size
        parts.append((first, end))
        first = end
    return parts
