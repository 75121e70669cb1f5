"""Modal assurance criterion of identified modes and those of a model, as a matrix."""

import numpy as np
from numpy.typing import ArrayLike

from pymc_features._checks import message
from pymc_features.modal import ModalData
from pymc_features.plots.drawing.axes import AxesLike, checked_axes
from pymc_features.plots.drawing.modal import Compared, compared, macs, quantiles

CELL, LARGEST = 0.62, 11.0  # inches, of a cell and of a figure
DARK = 0.6  # MAC above which letters are white
CLOSE = 0.005  # 5-95 % intervals that are narrower than this on both sides are not written


def plot_mac(
    measured: ModalData,
    shapes: ArrayLike,
    frequencies: ArrayLike | None = None,
    *,
    partners: ArrayLike | None = None,
    axes: AxesLike = None,
) -> np.ndarray:
    """Matrix of the MAC of identified modes and those of a model.

    Of draws of a posterior each cell has the median, and below it the 5-95 % interval where that is wider
    than a digit. Modes of draws are told apart by their order.

    Parameters
    ----------
    measured : ModalData
        i identified modes at s channels; entries that are NaN are left out.
    shapes : array_like (..., m, s)
        Of the model at the same channels, in rows; several dimensions in front are draws, such as (chain,
        draw, m, s).
    frequencies : array_like (..., m), optional
        Of the model [Hz], for the labels.
    partners : array_like of int (i,), optional
        Mode of the model that each identified mode is matched with, 0 the first; their cells get a frame.
    axes : matplotlib Axes, optional
        A new figure by default.

    Returns
    -------
    array of one matplotlib Axes

    See Also
    --------
    mac : the numbers.
    """
    given = compared(measured, shapes, frequencies, partners)
    if given.shapes.shape[2] != given.measured.shape[1]:
        raise ValueError(
            message(
                "shapes",
                f"(..., mode, channel) with the {given.measured.shape[1]} channels of `measured`",
                given.shapes.shape[1:],
                "Choose the degrees of freedom of the channels.",
            )
        )
    low, middle, high = quantiles(macs(given))
    i, m = middle.shape
    size = min(LARGEST, 1.9 + CELL * max(m, 3)), min(LARGEST, 1.4 + CELL * max(i, 2))
    [ax] = axes = checked_axes(axes, figsize=size)
    ax.imshow(np.ma.masked_invalid(middle), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    ax.set_facecolor("0.9")  # of modes without a shape
    font = min(9.0, 60.0 * min((size[0] - 1.9) / m, (size[1] - 1.4) / i) / 4.2)
    for row, column in np.ndindex(i, m):
        text = cell_text(low[row, column], middle[row, column], high[row, column])
        colour = "white" if middle[row, column] > DARK else "0.15"
        ax.text(column, row, text, ha="center", va="center", color=colour, fontsize=font, linespacing=1.3)
    if given.partners is not None:
        from matplotlib.patches import Rectangle

        for row, column in enumerate(given.partners):
            ax.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, ec="C1", lw=2.2, zorder=3))
    ax.set_xticks(range(m), of_model(given))
    ax.set_yticks(range(i), [f"{f:.4g}" for f in given.identified])
    hertz = "" if given.frequencies is None else " [Hz]"
    ax.set(xlabel=f"mode of the model{hertz}", ylabel="identified mode [Hz]")
    ax.tick_params(length=0)
    if m > 4 and hertz:
        ax.tick_params(axis="x", rotation=45)
    return axes


def cell_text(low: float, middle: float, high: float) -> str:
    """Median and interval, as far as two digits tell them apart."""
    if np.isnan(middle):
        return "-"
    if max(high - middle, middle - low) < CLOSE:
        return f"{middle:.2f}"
    return f"{middle:.2f}\n{low:.2f}-{high:.2f}"


def of_model(given: Compared) -> list[str]:
    """Number and median frequency of each mode of the model."""
    numbers = range(1, 1 + given.shapes.shape[1])
    if given.frequencies is None:
        return [f"f{k}" for k in numbers]
    return [f"f{k}: {f:.4g}" for k, f in zip(numbers, quantiles(given.frequencies)[1], strict=True)]
