"""The axes that a figure is drawn on: those given, or those of a new figure."""

import textwrap
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pymc_features._checks import as_array, is_among, message, shown

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
    from matplotlib.axes import Axes

    given, axes = axes, np.atleast_1d(as_array(axes)).ravel()
    if axes.size != count:
        wanted = f"one for each of {count} {each}" if each else "one"
        raise ValueError(f"`axes` must be {wanted}, got {axes.size}.")
    if not all(isinstance(ax, Axes) for ax in axes):
        raise TypeError(
            message("axes", "axes of matplotlib", shown(given), "Leave them out for a new figure.")
        )
    return axes


def chosen_among(chosen, name: str, known: list, advice: str = "") -> list:
    """Some labels of what there is, as a list; all of them for None."""
    if chosen is None:
        return list(known)
    array = as_array(chosen)
    labels = np.atleast_1d(array).tolist() if array.ndim < 2 else []
    if not labels or not all(is_among(label, known) for label in labels):
        advice = f" {advice}" if advice else ""
        raise ValueError(f"`{name}` must be among {known}, got {shown(labels or chosen)}.{advice}")
    return labels


def set_title(ax: "Axes", text: str, **style) -> None:
    """Put a text above an axis, in lines that are no wider than it, and as it is: a $ begins no formula."""
    from matplotlib import rcParams

    size = style.get("fontsize", rcParams["axes.titlesize"])
    ax.set_title(broken(text, inches_of(ax), size), parse_math=False, **style)


def set_figure_title(figure, text: str) -> None:
    """Put a text above a figure, in lines that are no wider than it."""
    from matplotlib import rcParams

    lines = broken(text, 0.95 * figure.get_figwidth(), rcParams["figure.titlesize"])
    figure.suptitle(lines, parse_math=False)


def inches_of(ax: "Axes") -> float:
    """Width of an axis before a layout has moved it."""
    return ax.get_window_extent().width / ax.figure.dpi


def broken(text: str, inches: float, size: str | float) -> str:
    """A text in lines, each no wider than some inches in the font size; words that are wider are split."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=size)

    def is_wider(letters):
        widths = (
            text_to_path.get_text_width_height_descent(line, font, False)[0]
            for line in textwrap.wrap(text, letters)
        )
        return max(widths, default=0.0) > 72.0 * inches

    # each width takes a while to compute: search, and not one number of letters after another
    letters = bisect_left(range(1, len(text) + 1), True, key=is_wider)
    return "\n".join(textwrap.wrap(text, letters)) if letters else text


def close(axes: "Iterable[Axes]") -> None:
    """Release the figures of some axes."""
    from matplotlib import pyplot

    for ax in axes:
        pyplot.close(ax.get_figure(root=True))
