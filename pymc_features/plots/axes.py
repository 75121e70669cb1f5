"""The axes that a figure is drawn on: those given, or those of a new figure."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # matplotlib takes a second to import
    from matplotlib.axes import Axes

type AxesLike = Axes | Sequence[Axes] | np.ndarray | None


def checked_axes(axes: AxesLike, count: int = 1, each: str = "", *, columns: int = 1, **figure) -> np.ndarray:
    """Return as many axes as asked for, as an array (axes,).

    Parameters
    ----------
    axes : matplotlib Axes, sequence or array of them, or None
        None makes a new figure.
    count : int
        How many there must be.
    each : str
        What they are for if there are several, in words for the error.
    columns : int
        Of a new figure.
    **figure
        Of `matplotlib.pyplot.subplots`, for a new figure.
    """
    if axes is None:
        from matplotlib import pyplot

        rows = -(-count // columns)
        _, grid = pyplot.subplots(rows, columns, layout="constrained", squeeze=False, **figure)
        for spare in grid.ravel()[count:]:
            spare.remove()
        return grid.ravel()[:count]
    axes = np.atleast_1d(np.asarray(axes, dtype=object)).ravel()
    if axes.size != count:
        wanted = f"one for each of {count} {each}" if each else "one"
        raise ValueError(f"`axes` must be {wanted}, got {axes.size}.")
    return axes


def close(axes: "Iterable[Axes]") -> None:
    """Release the figures of some axes."""
    from matplotlib import pyplot

    for ax in axes:
        pyplot.close(ax.figure)
