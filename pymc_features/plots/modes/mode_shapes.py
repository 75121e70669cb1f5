"""Identified mode shapes on those of a model, along the structure."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from pymc_features._checks import message
from pymc_features.modal import ModalData
from pymc_features.modal.shapes import real_shape
from pymc_features.plots.drawing.axes import AxesLike, checked_axes
from pymc_features.plots.drawing.modal import Compared, best_partners, compared, indices, macs, quantiles
from pymc_features.plots.drawing.nodes import Nodes, checked_nodes

DRAWN = 60  # draws, as thin lines
MODEL, MEASURED = "C0", "C1"


def plot_mode_shapes(
    measured: ModalData,
    shapes: ArrayLike,
    frequencies: ArrayLike | None = None,
    *,
    sensors: ArrayLike | None = None,
    nodes: Mapping[str, ArrayLike] | None = None,
    partners: ArrayLike | None = None,
    axes: AxesLike = None,
) -> np.ndarray:
    """Each identified mode shape on that of the model it is matched with.

    Of draws there are the median and a 5-95 % band, or in space thin lines. Each draw is scaled by the factor
    that brings it closest to what was measured, whose largest entry is 1: a' = phi' phi^ / (phi' phi).

    Parameters
    ----------
    measured : ModalData
        i identified modes at s channels. Entries that are NaN are not drawn; of complex shapes the real part
        is, turned as `ModalData.real` does.
    shapes : array_like (..., m, p)
        Of the model at all points that are to be drawn, in rows; several dimensions in front are draws, such
        as (chain, draw, m, p).
    frequencies : array_like (..., m), optional
        Of the model [Hz], for the titles.
    sensors : array_like of int (s,), optional
        Column of `shapes` that each channel measures; by default the columns are the channels.
    nodes : mapping, optional
        Where the points are: `coordinates` (p, 3) [m]; `directions` (p, 3), in which an entry moves its
        point, zeros where it is held (by default x where heights differ most, else z); `lines`, a list of
        lists of rows that are joined (by default all, in their order). Rows with the same coordinates are one
        node. By default the points are the storeys of a chain, the lowest first, above a base at rest.
    partners : array_like of int (i,), optional
        Mode of the model that each identified mode is matched with, 0 the first; by default those with the
        largest MAC in total.
    axes : sequence of matplotlib Axes, optional
        One for each identified mode; a new figure by default.

    Returns
    -------
    array of matplotlib Axes
    """
    given = compared(measured, shapes, frequencies, partners)
    s, p = given.measured.shape[1], given.shapes.shape[2]
    if sensors is None and s != p:
        raise ValueError(
            message("sensors", f"given for {s} channels and {p} columns of `shapes`", "None", COLUMNS)
        )
    places = np.arange(s) if sensors is None else indices("sensors", sensors, s, p, "column of `shapes`")
    plane = None if nodes is None else checked_nodes(nodes, p)
    agreement = macs(given, places)
    if given.partners is None:
        given = given._replace(partners=best_partners(quantiles(agreement)[1]))
    is_new, n = axes is None, len(given.measured)
    axes = checked_axes(axes, n, "identified modes", **layout_of(plane, n))
    for k, ax in enumerate(axes):
        shape = real_shape(given.measured[k])
        own = shape / np.nanmax(np.abs(shape)) if (~np.isnan(shape)).any() else shape
        draws = scaled(given.shapes[:, given.partners[k]], own, places)
        if plane is None:
            draw_storeys(ax, draws, own, places)
        else:
            draw_nodes(ax, plane, draws, own, places)
        words = title_of(given, agreement, k)
        lines = words if plane is None else [", ".join(words[:2]), words[2]]
        ax.set_title("\n".join(lines), fontsize="medium")
    if is_new:
        handles, labels = axes[0].get_legend_handles_labels()
        axes[0].figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    return axes


COLUMNS = "Say by `sensors` which column each channel measures."


def layout_of(plane: Nodes | None, n: int) -> dict:
    """Columns and size of a new figure with n axes."""
    if plane is None:
        columns = min(n, 5)
        size = 0.6 + 2.1 * columns, 0.9 + 3.6 * -(-n // columns)
        return {"columns": columns, "figsize": size, "sharey": True}
    wide, tall = np.ptp(plane.bounds, axis=0)
    columns = min(n, 1 if wide > 4.0 * tall else 2 if wide > 1.2 * tall else 4)
    width = min(9.0 / columns, 5.5 * wide / tall if wide < tall else 9.0)
    size = max(2.6, width) * columns, 0.6 + (min(5.5, width * tall / wide) + 0.9) * -(-n // columns)
    return {"columns": columns, "figsize": size}


def scaled(draws: np.ndarray, own: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Shapes (N, p), each times the factor that brings it closest to an identified one (s,)."""
    there = ~np.isnan(own)
    at = draws[:, places[there]]
    squares = np.sum(at**2, axis=1)
    factors = at @ own[there] / np.where(squares > 0.0, squares, 1.0)
    return factors[:, None] * draws


def title_of(given: Compared, agreement: np.ndarray, k: int) -> list[str]:
    """Frequencies of an identified mode and of its partner, f1 the lowest, and their MAC."""
    r = given.partners[k]
    words = f"model f{r + 1}"
    if given.frequencies is not None:
        words += f": {quantiles(given.frequencies[:, r])[1]:.4g} Hz"
    middle = quantiles(agreement[:, k, r])[1]
    of_shape = "no shape" if np.isnan(middle) else f"MAC {middle:.3f}"
    return [f"measured {given.identified[k]:.4g} Hz", words, of_shape]


def draw_storeys(ax, draws, own, places):
    """Shapes of a chain above its base."""
    low, middle, high = (np.append(0.0, row) for row in quantiles(draws))
    storeys = np.arange(middle.size)
    ax.axvline(0.0, color="0.8", lw=0.8, zorder=0)
    if len(draws) > 1:
        ax.fill_betweenx(storeys, low, high, color=MODEL, alpha=0.3, lw=0, label="model, 90 %")
    ax.plot(middle, storeys, color=MODEL, lw=1.5, label="model, median" if len(draws) > 1 else "model")
    ax.plot(own, places + 1, "o", color=MEASURED, ms=6, label="measured")
    widest = 1.1 * max(1.0, np.abs([low, high]).max(), np.nanmax(np.abs(own), initial=0.0))
    ax.set(
        xlim=(-widest, widest), ylim=(0.0, 1.03 * (middle.size - 1)), xlabel="shape [-]", xticks=[-1, 0, 1]
    )
    ax.yaxis.get_major_locator().set_params(integer=True)
    if ax.get_subplotspec() is None or ax.get_subplotspec().is_first_col():
        ax.set_ylabel("storey")


def draw_nodes(ax, plane, draws, own, places):
    """Shapes of a structure in space."""
    from matplotlib.collections import LineCollection

    few = draws[np.linspace(0, len(draws) - 1, min(DRAWN, len(draws))).astype(int)]
    still, middle = plane.places, plane.moved(quantiles(draws)[1])
    ax.add_collection(LineCollection([still[line] for line in plane.lines], color="0.75", lw=0.8, zorder=0))
    if len(draws) > 1:
        thin = [each[line] for each in plane.moved(few) for line in plane.lines]
        ax.add_collection(LineCollection(thin, color=MODEL, alpha=0.12, lw=1.0))
        ax.plot([], [], color=MODEL, alpha=0.35, lw=1.0, label="model, draws")
    for number, line in enumerate(plane.lines):
        named = "model, median" if len(draws) > 1 else "model"
        label = named if number == 0 else None
        ax.plot(*middle[line].T, color=MODEL, lw=1.5, label=label)
    shape = np.full(draws.shape[1], np.nan)
    shape[places] = own
    there = np.unique(plane.node[~np.isnan(shape)])
    ax.plot(*plane.moved(shape)[there].T, "o", color=MEASURED, ms=4.5, label="measured")
    ax.set_aspect("equal")
    (left, bottom), (right, top) = plane.bounds
    ax.set(xlim=(left, right), ylim=(bottom, top), xlabel=plane.labels[0], ylabel=plane.labels[1])
