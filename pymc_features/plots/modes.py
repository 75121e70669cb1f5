"""Identified modes and those of a model: their modal assurance criterion, and their shapes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import ArrayLike

from pymc_features._checks import as_array, as_numbers, check_mapping, message, shown
from pymc_features.modal.data import ModalData, real_shape
from pymc_features.modal.data import mac as mac_of
from pymc_features.plots.axes import AxesLike, checked_axes, figure, legend_outside

type ShapesLike = ArrayLike | object  # shapes, or modes that have them

CELL, LARGEST = 0.62, 11.0  # inches, of a cell of a matrix and of all
DARK = 0.6  # MAC above which letters are white
CLOSE = 0.005  # 5-95 % intervals that are narrower than this on both sides are not written
DRAWN = 60  # draws, as thin lines
MODEL, MEASURED = "C0", "C1"
KEYS = ("coordinates", "directions", "lines")
DEPTH = 0.45  # of the second axis, drawn obliquely
OBLIQUE = np.array([[1.0, 0.0], [DEPTH * np.cos(0.6), DEPTH * np.sin(0.6)], [0.0, 1.0]])
ROOM = 1.3  # beyond the largest measured entry
AMPLITUDE = 0.15  # of the largest entry, over the extent of the structure


@figure("One", "array of one matplotlib Axes")
def mac(
    measured: ModalData,
    shapes: ShapesLike,
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
    shapes : array_like (..., m, s), or modes
        Of the model at the same channels, in rows; several dimensions in front are draws, such as (chain,
        draw, m, s). Or modes with their frequencies: what `modes` returned, of a structure or inside a model
        where it is of numbers, or a `modal.ModalData`.
    frequencies : array_like (..., m), optional
        Of the model [Hz], for the labels.
    partners : array_like of int (i,), optional
        Mode of the model that each identified mode is matched with, 0 the first; their cells get a frame.

    See Also
    --------
    modal.mac : the numbers.
    """
    given = Compared(measured, shapes, frequencies, partners)
    if given.shapes.shape[2] != given.measured.shape[1]:
        condition = f"(..., mode, channel) with the {given.measured.shape[1]} channels of `measured`"
        advice = "Choose the degrees of freedom of the channels."
        raise ValueError(message("shapes", condition, given.shapes.shape[1:], advice))
    low, middle, high = quantiles(given.macs())
    i, m = middle.shape
    size = min(LARGEST, 1.9 + CELL * max(m, 3)), min(LARGEST, 1.4 + CELL * max(i, 2))
    [ax] = axes = checked_axes(axes, figsize=size)
    ax.imshow(np.ma.masked_invalid(middle), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    ax.set_facecolor("0.9")  # of modes without a shape
    font = min(9.0, 60.0 * min((size[0] - 1.9) / m, (size[1] - 1.4) / i) / 4.2)
    style = {"ha": "center", "va": "center", "fontsize": font, "linespacing": 1.3}
    for row, column in np.ndindex(i, m):
        text = cell_text(low[row, column], middle[row, column], high[row, column])
        ax.text(column, row, text, color="white" if middle[row, column] > DARK else "0.15", **style)
    if given.partners is not None:
        from matplotlib.patches import Rectangle

        for row, column in enumerate(given.partners):
            ax.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, ec="C1", lw=2.2, zorder=3))
    ax.set_xticks(range(m), [f"f{k + 1}{given.frequency(k, ': {:.4g}')}" for k in range(m)])
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
    is_close = max(high - middle, middle - low) < CLOSE
    return f"{middle:.2f}" if is_close else f"{middle:.2f}\n{low:.2f}-{high:.2f}"


@figure("One for each identified mode")
def mode_shapes(
    measured: ModalData,
    shapes: ShapesLike,
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
    shapes : array_like (..., m, p), or modes
        Of the model at all points that are to be drawn, in rows; several dimensions in front are draws, such
        as (chain, draw, m, p). Or modes as `plots.mac` takes them.
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
    """
    given = Compared(measured, shapes, frequencies, partners)
    (n, s), p = given.measured.shape, given.shapes.shape[2]
    if sensors is None and s != p:
        advice = "Say by `sensors` which column each channel measures."
        raise ValueError(
            message("sensors", f"given for {s} channels and {p} columns of `shapes`", "None", advice)
        )
    places = np.arange(s) if sensors is None else indices("sensors", sensors, s, p, "column of `shapes`")
    plane = None if nodes is None else checked_nodes(nodes, p)
    agreement = quantiles(given.macs(places))[1]
    matched = best_partners(agreement) if given.partners is None else given.partners
    is_new = axes is None
    axes = checked_axes(axes, n, "identified modes", **layout_of(plane, n))
    for ax, identified, shape, r, values in zip(
        axes, given.identified, given.measured, matched, agreement, strict=True
    ):
        shape = real_shape(shape)
        shape = shape / np.nanmax(np.abs(shape)) if (~np.isnan(shape)).any() else shape
        draws = scaled(given.shapes[:, r], shape, places)
        if plane is None:
            draw_storeys(ax, draws, shape, places)
        else:
            draw_nodes(ax, plane, draws, shape, places)
        model = f"model f{r + 1}{given.frequency(r, ': {:.4g} Hz')}"
        of_shape = "no shape" if np.isnan(values[r]) else f"MAC {values[r]:.3f}"
        between = ", " if plane else "\n"
        ax.set_title(f"measured {identified:.4g} Hz{between}{model}\n{of_shape}", fontsize="medium")
    if is_new:
        legend_outside(axes[0], columns=3)
    return axes


@dataclass
class Compared:
    """Identified modes, i of them at s channels, and N draws of m modes of a model at p points; checked."""

    measured: np.ndarray  # (i, s), real or complex, NaN where an entry is missing; given as ModalData
    shapes: np.ndarray  # (N, m, p) of the model; N = 1 of one structure
    frequencies: np.ndarray | None  # (N, m) of the model [Hz]
    partners: np.ndarray | None  # (i,), mode of the model that each is matched with

    def __post_init__(self):
        data, advice = self.measured, "Read it with `read_modal`, and the shapes as well."
        if not isinstance(data, ModalData) or data.shapes is None:
            got = "frequencies alone" if isinstance(data, ModalData) else shown(data)
            raise ValueError(message("measured", "a ModalData with shapes", got, advice))
        self.measured, self.identified = data.shapes, data.frequencies
        shapes, self.frequencies = shapes_and_frequencies(self.shapes, self.frequencies)
        shapes = as_numbers(shapes, "shapes", "Pass those of the model.")
        draws = shapes.reshape(-1, *shapes.shape[-2:])
        self.shapes = draws[np.isfinite(draws).all(axis=(1, 2))]
        if not len(self.shapes):
            raise ValueError(message("shapes", "finite in some draw", "NaN or infinity in all"))
        m = shapes.shape[-2]
        if self.frequencies is not None:
            hertz = as_numbers(self.frequencies, "frequencies", "Pass those of the model in Hz.")
            known = hertz[~np.isnan(hertz)]
            are_positive = known.size and ((known > 0.0) & (known < np.inf)).all()
            if hertz.shape != shapes.shape[:-1] or not are_positive:
                condition = f"{shapes.shape[:-1]} positive numbers in Hz"
                raise ValueError(message("frequencies", condition, hertz.shape))
            self.frequencies = hertz.reshape(-1, m)
        if self.partners is not None:
            self.partners = indices("partners", self.partners, len(data), m, "mode of the model")

    def macs(self, sensors=slice(None)) -> np.ndarray:
        """MAC (N, i, m) of each identified mode and each mode of the model, NaN without a shape."""
        draws, m, _ = self.shapes.shape
        found = mac_of(self.measured, self.shapes[:, :, sensors].reshape(draws * m, -1))
        return found.reshape(-1, draws, m).transpose(1, 0, 2)

    def frequency(self, mode: int, form: str) -> str:
        """Median frequency of a mode of the model in some form; nothing if it has none."""
        return "" if self.frequencies is None else form.format(quantiles(self.frequencies[:, mode])[1])


def shapes_and_frequencies(modes, frequencies) -> tuple:
    """Shapes in rows and frequencies [Hz] of modes; arrays stay as they are."""
    if hasattr(modes, "mode_shapes"):
        found = modes.mode_shapes.T, modes.natural_frequencies
    elif hasattr(modes, "shapes") and hasattr(modes, "frequencies"):
        found = modes.shapes, modes.frequencies
    else:
        return modes, frequencies
    if all(hasattr(variable, "eval") for variable in found):
        found = constants(found)
    return found[0], found[1] if frequencies is None else frequencies


def constants(variables) -> list[np.ndarray]:
    """Values of variables that depend on nothing random."""
    from pytensor.graph.basic import Constant
    from pytensor.graph.traversal import ancestors

    from pymc_features.modal.feature import IN_PYTHON

    if any(v.owner is None and not isinstance(v, Constant) for v in ancestors(variables)):
        advice = "Pass the shapes of draws, or build the structure with numbers."
        raise TypeError(message("shapes", "modes of numbers", "those of random variables", advice))
    return [variable.eval(mode=IN_PYTHON) for variable in variables]


def indices(name: str, values, n: int, most: int, what: str) -> np.ndarray:
    """An index from 0 to `most` - 1 for each of n."""
    array = as_array(values)
    is_whole = array.dtype.kind in "iu" and array.shape == (n,)
    if not is_whole or not ((array >= 0) & (array < most)).all():
        condition = f"{n} whole numbers from 0 to {most - 1}"
        raise ValueError(message(name, condition, shown(values), f"Give the {what} of each."))
    return array


def best_partners(agreement: np.ndarray) -> np.ndarray:
    """Modes (i,) of the model with the largest MAC (i, m) in total, each taken once."""
    from scipy.optimize import linear_sum_assignment

    i, m = agreement.shape
    agreement = np.nan_to_num(agreement)
    return agreement.argmax(axis=1) if i > m else linear_sum_assignment(-agreement)[1]


def quantiles(values: np.ndarray) -> np.ndarray:
    """5, 50 and 95 % (3, ...) over the first axis; NaN where all are."""
    with catch_warnings():
        simplefilter("ignore", RuntimeWarning)  # of places that are NaN in all draws
        return np.nanquantile(values, [0.05, 0.5, 0.95], axis=0)


def layout_of(plane: "Nodes | None", n: int) -> dict:
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


def scaled(draws: np.ndarray, shape: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Shapes (N, p), each times the factor that brings it closest to an identified one (s,)."""
    there = ~np.isnan(shape)
    at = draws[:, places[there]]
    squares = np.sum(at**2, axis=1)
    factors = at @ shape[there] / np.where(squares > 0.0, squares, 1.0)
    return factors[:, None] * draws


def draw_storeys(ax, draws, shape, places):
    """Shapes of a chain above its base."""
    low, middle, high = (np.append(0.0, row) for row in quantiles(draws))
    storeys = np.arange(middle.size)
    ax.axvline(0.0, color="0.8", lw=0.8, zorder=0)
    if len(draws) > 1:
        ax.fill_betweenx(storeys, low, high, color=MODEL, alpha=0.3, lw=0, label="model, 90 %")
    ax.plot(middle, storeys, color=MODEL, lw=1.5, label=label_of(draws))
    ax.plot(shape, places + 1, "o", color=MEASURED, ms=6, label="measured")
    widest = 1.1 * max(1.0, np.abs([low, high]).max(), np.nanmax(np.abs(shape), initial=0.0))
    ax.set(xlim=(-widest, widest), ylim=(0.0, 1.03 * (middle.size - 1)), xlabel="shape [-]")
    ax.set_xticks([-1, 0, 1])
    ax.yaxis.get_major_locator().set_params(integer=True)
    if ax.get_subplotspec() is None or ax.get_subplotspec().is_first_col():
        ax.set_ylabel("storey")


def draw_nodes(ax, plane, draws, shape, places):
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
        ax.plot(*middle[line].T, color=MODEL, lw=1.5, label=None if number else label_of(draws))
    entries = np.full(draws.shape[1], np.nan)
    entries[places] = shape
    there = np.unique(plane.node[~np.isnan(entries)])
    ax.plot(*plane.moved(entries)[there].T, "o", color=MEASURED, ms=4.5, label="measured")
    ax.set_aspect("equal")
    (left, bottom), (right, top) = plane.bounds
    ax.set(xlim=(left, right), ylim=(bottom, top), xlabel=plane.labels[0], ylabel=plane.labels[1])


def label_of(draws) -> str:
    """What the line of the model is."""
    return "model, median" if len(draws) > 1 else "model"


# ---- a structure in space, seen in a plane ----


class Nodes(NamedTuple):
    """Points of a structure in the plane of the figure."""

    places: np.ndarray  # (k, 2) of the nodes; several entries of a shape may belong to one
    node: np.ndarray  # (p,) of each entry
    directions: np.ndarray  # (p, 2) in which an entry moves its node, zero where it is held; 1 in space
    lines: list[np.ndarray]  # nodes that are joined
    labels: tuple[str, str]  # of the axes of the figure

    @property
    def extent(self) -> float:
        """Length that amplitudes are a share of."""
        return float(np.ptp(self.places, axis=0).max()) or 1.0

    @property
    def bounds(self) -> np.ndarray:
        """Corners (2, 2) of what nodes reach."""
        reach = ROOM * AMPLITUDE * self.extent * np.abs(self.directions).max(axis=0)
        margin = np.maximum(reach, 0.04 * self.extent)
        return np.array([self.places.min(axis=0) - margin, self.places.max(axis=0) + margin])

    def moved(self, shape: np.ndarray) -> np.ndarray:
        """Places (..., k, 2) under a shape (..., p) with entries of at most about 1; NaN does not move."""
        steps = AMPLITUDE * self.extent * np.nan_to_num(shape)[..., None] * self.directions
        found = np.broadcast_to(self.places, (*shape.shape[:-1], *self.places.shape)).copy()
        for entry, node in enumerate(self.node):
            found[..., node, :] += steps[..., entry, :]
        return found


def checked_nodes(nodes, p: int) -> Nodes:
    """Nodes in the plane in which they lie and move, or obliquely from in front."""
    what = f"a mapping of {', '.join(KEYS)}"
    given = check_mapping(nodes, "nodes", what)
    if not {"coordinates"} <= set(given) <= set(KEYS):
        raise ValueError(message("nodes", what, ", ".join(given) or "nothing"))
    points = rows_of(given["coordinates"], "coordinates", p)
    directions = given.get("directions")
    if directions is None:
        rises = np.ptp(points[:, 2]) >= max(np.ptp(points[:, 0]), np.ptp(points[:, 1]))
        directions = np.tile([1.0, 0.0, 0.0] if rises else [0.0, 0.0, 1.0], (p, 1))
    directions = rows_of(directions, "directions", p)
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions / np.where(length > 0.0, length, 1.0)
    places, node = np.unique(points, axis=0, return_inverse=True)
    lines = [range(p)] if given.get("lines") is None else given["lines"]
    if not {row for line in lines for row in line} <= set(range(p)):
        condition = f"with lines that are lists of rows from 0 to {p - 1}"
        raise ValueError(message("nodes", condition, shown(lines)))
    projection, labels = plane_of(points, directions)
    joined = [node[list(line)] for line in lines]
    return Nodes(places @ projection, node, directions @ projection, joined, labels)


def rows_of(values, name: str, p: int) -> np.ndarray:
    """Vectors (p, 3) in space; of two columns the third is zero."""
    array = as_numbers(values, "nodes", f"Give {name} in metres.")
    if array.shape not in ((p, 2), (p, 3)) or not np.isfinite(array).all():
        condition = f"with {p} rows of 2 or 3 finite {name}, one for each column of `shapes`"
        raise ValueError(message("nodes", condition, array.shape))
    return np.pad(array, ((0, 0), (0, 3 - array.shape[1])))


def plane_of(points: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, tuple[str, str]]:
    """A projection (3, 2) and the labels of its axes."""
    used = [k for k in range(3) if np.ptp(points[:, k]) > 0.0 or directions[:, k].any()]
    if len(used) > 2:
        return OBLIQUE, ("x [m]", "z [m]")
    for missing in (2, 0, 1):
        if len(used) < 2 and missing not in used:
            used = sorted([*used, missing])
    return np.eye(3)[:, used], tuple(f"{'xyz'[k]} [m]" for k in used)
