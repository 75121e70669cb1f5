"""What figures have in common: the axes that they are drawn on, their texts, and what they refuse."""

import textwrap
from collections.abc import Callable, Iterable, Sequence
from inspect import cleandoc
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from pymc_features._checks import as_array, is_among, message, shown

if TYPE_CHECKING:  # matplotlib takes a second to import
    from matplotlib.axes import Axes

LETTER = 0.6  # mean width of letters over the size of the font; 0.65 of capitals
type AxesLike = Axes | Sequence[Axes] | np.ndarray | None

OF_ALL = """
axes : matplotlib Axes or sequence of them, optional
    {each}; a new figure by default.

Returns
-------
{returns}"""


def figure[F: Callable](each: str, returns: str = "array of matplotlib Axes") -> Callable[[F], F]:
    """Complete the docstring of a function that draws: its `axes`, one for `each`, and what it returns."""

    def completed(draw: F) -> F:
        text, *more = cleandoc(draw.__doc__).split("\n\nSee Also")
        draw.__doc__ = "\n\nSee Also".join([text + OF_ALL.format(each=each, returns=returns), *more])
        return draw

    return completed


def checked_axes(axes: AxesLike, count: int = 1, each: str = "", *, columns: int = 1, **figure) -> np.ndarray:
    """Return as many axes as asked for, as an array (axes,); None makes a new figure of `columns`.

    There must be `count`, one for `each` of several things, in words for the error; `figure` are arguments of
    `matplotlib.pyplot.subplots`.
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
        raise ValueError(message(name, f"among {known}", shown(labels or chosen), advice))
    return labels


def check_dataset(value, name: str, source: str, *variables: str) -> None:
    """Refuse what is no Dataset with these variables."""
    if not isinstance(value, xr.Dataset) or not set(variables) <= set(value.data_vars):
        raise TypeError(message(name, "a Dataset", shown(value), f"Pass {source}."))


def set_title(ax: "Axes", text: str, **style) -> None:
    """Put a text above an axis, in lines that are no wider than it, and as it is: a $ begins no formula."""
    from matplotlib import rcParams

    size = style.get("fontsize", rcParams["axes.titlesize"])
    ax.set_title(broken(text, inches_of(ax), size), parse_math=False, **style)


def set_figure_title(figure, *texts: str | None) -> None:
    """Put texts above a figure, with commas between them and in lines that are no wider than it."""
    from matplotlib import rcParams

    title = ", ".join(filter(None, texts))
    lines = broken(title, 0.95 * figure.get_figwidth(), rcParams["figure.titlesize"])
    figure.suptitle(lines, parse_math=False)


def legend_outside(ax: "Axes", place: str = "upper center", columns: int | None = None) -> None:
    """Put a legend of what an axis shows beside all axes of its figure."""
    handles, labels = ax.get_legend_handles_labels()
    columns = columns or len(labels)
    ax.figure.legend(handles, labels, loc=f"outside {place}", ncols=columns, frameon=False)


def with_unit(name: str, unit: str) -> str:
    """A name with its unit, if it has one."""
    return f"{name} [{unit.replace('^2', '²')}]".strip() if unit else name


def inches_of(ax: "Axes") -> float:
    """Width of an axis before a layout has moved it."""
    return ax.get_window_extent().width / ax.figure.dpi


def broken(text: str, inches: float, size: str | float) -> str:
    """A text in lines of as many letters as some inches hold in the font size; longer words are split."""
    from matplotlib.font_manager import FontProperties

    letters = int(72.0 * inches / (LETTER * FontProperties(size=size).get_size_in_points()))
    return textwrap.fill(text, max(1, letters))


def close(axes: "Iterable[Axes]") -> None:
    """Release the figures of some axes."""
    from matplotlib import pyplot

    for ax in axes:
        pyplot.close(ax.get_figure(root=True))
