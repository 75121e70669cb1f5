"""Draws of a posterior, drawn by arviz-plots in any of its backends.

Do chains agree, what have the data taught, and where are the natural frequencies?
"""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from pymc_features._checks import check_choice, check_finite, check_group, check_mapping, message, shown
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.plots.axes import (
    AxesLike,
    broken,
    checked_axes,
    chosen_among,
    figure,
    inches_of,
    with_unit,
)

if TYPE_CHECKING:
    from arviz_plots import PlotCollection

KINDS = ("rank", "trace")
BACKENDS = ("matplotlib", "plotly", "bokeh")
RETURNS = "array of matplotlib Axes, or arviz_plots.PlotCollection with another backend"
SAMPLE = ("chain", "draw")
LEGEND = {"matplotlib": "label", "bokeh": "legend_label"}
BINS = 40
BESIDE = 1.5  # width of the posterior on each side of it
GROUPED = ("group", "kwarg", "corner")  # what arviz-plots takes for an area
PRIOR, POSTERIOR = "#b0b0b0", "#1f77b4"


@figure("Two for each entry of a parameter, the density first", RETURNS)
def chains(
    idata: xr.DataTree,
    kind: str = "rank",
    var_names: Sequence[str] | None = None,
    axes: AxesLike = None,
    *,
    backend: str = "matplotlib",
) -> "np.ndarray | PlotCollection":
    """Density of each chain, and the ranks of its draws among all, or their trace.

    The curves of chains that agree, ranks less what is expected of them, stay near the middle; p is that of
    ArviZ's test of it. Draws of SMC have no order: look at ranks; those of NUTS have a trace as well.

    Parameters
    ----------
    idata : DataTree
        With a group `posterior`.
    kind : {"rank", "trace"}
    var_names : sequence of str, optional
        Parameters to draw; all by default.
    backend : {"matplotlib", "plotly", "bokeh"}
        What draws.
    """
    check_choice(kind, "kind", KINDS)
    posterior = check_group(idata, "idata", "posterior", "Pass what `sample` returned.", *SAMPLE)
    numbers = [name for name, values in posterior.data_vars.items() if values.dtype.kind in "iuf"]
    names = chosen_among(var_names, "var_names", numbers)
    if not names:
        raise ValueError("`idata` must have a posterior of numbers, got none.")
    for name in names:
        check_finite(posterior[name].values, "idata", f"Those are draws of {name}.")
    entries = scalars(posterior[names])
    n, each = len(entries), "columns (two for each entry of a parameter)"
    panels = Panels(axes, backend, 2 * n, each, columns=2, figsize=(9.0, 0.5 + 0.8 * n))
    columns = {"column": ["dist", kind]}
    pairs = dict(zip(entries, panels.targets.reshape(-1, 2), strict=True))
    collection = panels.collection(
        entries.expand_dims(columns), pairs, columns, {"color": ["chain"], "overlay": ["chain"]}
    )
    import arviz_plots as azp  # slow to import

    groups = {"posterior": entries}
    if "sample_stats" in idata.children:
        groups["sample_stats"] = idata["sample_stats"].to_dataset()
    draw = azp.plot_rank_dist if kind == "rank" else azp.plot_trace_dist
    draw(xr.DataTree.from_dict(groups), compact=False, plot_collection=collection, visuals={"label": False})
    second = ": fractional rank" if kind == "rank" else ": draw"
    for name, pair in pairs.items():
        for target, label in zip(pair, (name, f"{name}{second}"), strict=True):
            panels.module.xlabel(label, target)
    return panels.drawn(collection)


@figure("One for each parameter", RETURNS)
def prior_posterior(
    idata: xr.DataTree,
    var_names: Sequence[str] | None = None,
    units: Mapping[str, str] | None = None,
    axes: AxesLike = None,
    *,
    backend: str = "matplotlib",
) -> "np.ndarray | PlotCollection":
    """Histograms of prior and posterior of each scalar parameter, each to its own height, and the median.

    As densities a narrow posterior would leave no prior to see. The axis is the posterior's, 0.1 to 99.9 % of
    its draws and as much again and a half on each side; what the prior has beyond, up to 0.5 and 99.5 %, the
    label says.

    Parameters
    ----------
    idata : DataTree
        Groups `posterior` and `prior` (chain, draw).
    var_names : sequence of str, optional
        Parameters to draw; by default all scalars that both groups have.
    units : dict, optional
        Names of parameters to their units, for the labels.
    backend : {"matplotlib", "plotly", "bokeh"}
        What draws.
    """
    advice = "Pass draws of both, such as one likelihood of what `run_update` returned."
    posterior, prior = (
        check_group(idata, "idata", group, advice, *SAMPLE) for group in ("posterior", "prior")
    )
    units = check_mapping(units, "units", "a dict of parameters to their units")
    known = [str(n) for n, v in posterior.data_vars.items() if n in prior and set(v.dims) == set(SAMPLE)]
    names = chosen_among(var_names, "var_names", known)
    if not names:
        raise ValueError("`idata` must have scalar parameters in both groups, got none.")
    spans, outlines, beyond = {}, {}, {}
    for name in names:
        before, after = prior[name].values, posterior[name].values
        (first, last), ends = np.quantile(after, [0.001, 0.999]), np.quantile(before, [0.005, 0.995])
        whole, room = (min(first, ends[0]), max(last, ends[1])), BESIDE * (last - first)
        outlines[name] = GROUPED, [outline(before, *whole), outline(after, first, last)]
        spans[name] = max(whole[0], first - room), min(whole[1], last + room)
        if spans[name] != whole:
            beyond[name] = f"prior {ends[0]:.3g} to {ends[1]:.3g}"
    labels = {"group": ["prior", "posterior"], "kwarg": ["x", "y_bottom", "y_top"]}
    columns = min(4, len(names))
    size = 2.6 * columns, 0.5 + 2.2 * -(-len(names) // columns)
    panels = Panels(axes, backend, len(names), "parameters", columns=columns, figsize=size)
    placed = dict(zip(names, panels.targets, strict=True))
    aes = {"color": ["group"], "overlay": ["group"]}
    collection = panels.collection(xr.Dataset(outlines, labels), placed, {}, aes, color=[PRIOR, POSTERIOR])
    import arviz_plots as azp  # slow to import

    collection.map(azp.visuals.fill_between_y, "histogram", alpha=0.6)
    # a posterior thinner than a line is seen
    medians, style = posterior[names].median(SAMPLE), {"color": POSTERIOR, "width": 1.0, **panels.in_front}
    collection.map(azp.visuals.vline, "median", data=medians, ignore_aes="all", **style)
    for name, target in placed.items():
        label = with_unit(name, units.get(name, ""))
        lines = [broken(label, panels.inches, "medium"), beyond.get(name, "")]
        panels.module.xlabel(panels.line_end.join(filter(None, lines)), target)
        panels.module.xlim(spans[name], target)
        panels.module.remove_axis(target, axis="y")
        if panels.is_matplotlib:
            told = target.xaxis.get_major_formatter().format_ticks(target.get_xticks())
            fewer = max(map(len, told), default=0) > 6  # such as 0.00975: four of them would touch
            target.xaxis.get_major_locator().set_params(nbins=3 if fewer else 4)
    collection.add_legend("group", title="", **panels.legend)
    return panels.drawn(collection)


@figure("Two, for gains and frequencies", RETURNS)
def natural_frequencies(
    result: xr.DataTree, axes: AxesLike = None, *, backend: str = "matplotlib"
) -> "np.ndarray | PlotCollection":
    """Measured gain against frequency, and below it the 5-95 % intervals of every likelihood and mode.

    Dashed lines are frequencies given by the user, dotted ones the peaks of the measured gain.

    Parameters
    ----------
    result : DataTree
        From `run_update`: `data` with gain (sensor, frequency) [-] and peak_frequency, perhaps
        given_frequency [Hz]; natural_frequency (chain, draw, mode) [Hz] in `<likelihood>/modal`.
    backend : {"matplotlib", "plotly", "bokeh"}
        What draws.
    """
    advice = "Pass what `run_update` returned."
    parts = getattr(result, "children", {})
    kinds = [name for name, part in parts.items() if "modal" in part.children]
    if not kinds:
        raise ValueError("`result` must have a likelihood with natural frequencies, got none.")
    data = check_group(result, "result", "data", advice, "sensor", "frequency")
    height = 0.35 * len(kinds)
    layout = {"figsize": (9.0, 3.2 + height), "sharex": True, "height_ratios": [2.2, 0.5 + height]}
    panels = Panels(axes, backend, 2, "parts (gain, frequencies)", **layout)
    draw, (gains, intervals), top = panels.module, panels.targets, 0.0
    frequency, gain = data["frequency"].values, data["gain"].transpose("sensor", "frequency").values
    for number, (sensor, values) in enumerate(zip(data["sensor"].values, gain, strict=True)):
        style = {"color": f"C{number}", "width": 1.0}
        draw.line(frequency, values, gains, **style, **panels.named(str(sensor)))
    for row, kind in enumerate(kinds):
        found = result[f"{kind}/modal"]["natural_frequency"]
        low, middle, high = found.quantile([0.05, 0.5, 0.95], dim=SAMPLE).values
        colour = LIKELIHOODS[kind].colour
        for ends in zip(low, high, strict=True):
            draw.line(ends, [row, row], intervals, color=colour, width=5.0, alpha=0.4)
        draw.scatter(middle, np.full(middle.size, row), intervals, color=colour, width=0)
        top = max(top, float(np.nanmax(high)))
    marks = ("peak_frequency", "C2", "peaks of the gain"), ("given_frequency", "C1", "given")
    for name, dashes, label in marks:
        for number, value in enumerate(data[name].values if name in data else []):
            for target in panels.targets:
                named = panels.named(label) if number == 0 and target is gains else {}
                draw.vline(value, target, color="#666666", linestyle=dashes, width=0.9, **named)
    last = min(1.3 * top, float(frequency[-1]))
    largest = float(gain[:, frequency <= last].max())
    draw.yscale(gains, "log")
    draw.ylim(panels.on_log_axis(1e-3 * largest, 2.0 * largest), gains)
    draw.ylabel("gain against base [-]", gains)
    draw.yticks(list(range(len(kinds))), kinds, intervals)
    draw.xlim((0.0, last), intervals)
    draw.ylim((len(kinds) - 0.5, -0.5), intervals)
    draw.xlabel("frequency [Hz]", intervals)
    if panels.is_matplotlib:
        gains.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    found = xr.Dataset({"gain": data["gain"], "natural_frequency": found})
    placed = {"gain": gains, "natural_frequency": intervals}
    return panels.drawn(panels.collection(found, placed, {}, {}))


def scalars(draws: xr.Dataset) -> xr.Dataset:
    """Each entry of the parameters as a variable (chain, draw) with its name, such as k[0, 1]."""
    from arviz_base import labels, xarray_sel_iter  # slow to import

    found, named = {}, labels.IdxLabeller()
    for name, at, place in xarray_sel_iter(draws, skip_dims={*SAMPLE}):
        entry = draws[name].isel(place).transpose(*SAMPLE)
        found[named.make_label_flat(name, at, place)] = entry.reset_coords(drop=True)
    return xr.Dataset(found)


def outline(draws: np.ndarray, low: float, high: float) -> np.ndarray:
    """Corners x, bottom and top (3, corner) of a histogram of height 1."""
    counts, edges = np.histogram(draws, np.linspace(low, high, BINS + 1))
    top = np.concatenate([[0.0], np.repeat(counts / counts.max(), 2), [0.0]])
    return np.stack([np.repeat(edges, 2), np.zeros(2 * BINS + 2), top])


def module_of(backend: str):
    """How arviz-plots draws with a backend."""
    try:
        return import_module(f"arviz_plots.backend.{backend}")
    except ImportError as error:
        raise ImportError(
            f"`backend` must be installed, got {backend!r} without {error.name}. "
            f"Run pip install 'arviz-plots[{backend}]'."
        ) from error


class Panels:
    """Place for arviz-plots to draw: the axes given, or a new figure of some backend; see `checked_axes`."""

    def __init__(self, axes, backend, count, each, columns=1, **figure):
        self.backend = check_choice(backend, "backend", BACKENDS)
        self.module, self.is_matplotlib = module_of(backend), backend == "matplotlib"
        self.line_end = "<br>" if backend == "plotly" else "\n"
        if self.is_matplotlib:
            self.targets = checked_axes(axes, count, each, columns=columns, **figure)
            self.figure, self.inches = self.targets[0].figure, inches_of(self.targets[0])
            if axes is None:
                self.figure.get_layout_engine().set(w_pad=0.12)  # inches, between the numbers of neighbours
            self.legend = {"loc": "outside upper center", "ncols": 2, "frameon": False}
            self.in_front = {"zorder": 2}
            return
        if axes is not None:
            raise ValueError(message("axes", f"left out with backend={backend!r}", shown(axes)))
        wide, tall = figure.pop("figsize")
        figure |= {"figsize": (100.0 * wide, 100.0 * tall), "figsize_units": "dots", "squeeze": False}
        self.figure, grid = self.module.create_plotting_grid(count, -(-count // columns), columns, **figure)
        self.targets, self.inches = grid.ravel()[:count], 0.9 * wide / columns
        self.legend, self.in_front = {}, {}  # backends of browsers do well by themselves

    def named(self, label: str) -> dict:
        """How a line gets its place in a legend."""
        of_plotly = {"name": label, "showlegend": True}
        return of_plotly if self.backend == "plotly" else {LEGEND[self.backend]: label}

    def on_log_axis(self, *ends: float) -> tuple[float, ...]:
        """Ends of a logarithmic axis; plotly has them as powers of ten."""
        return tuple(np.log10(ends)) if self.backend == "plotly" else ends

    def collection(self, data: xr.Dataset, placed: Mapping, coords: Mapping, aes: Mapping, **values):
        """The panels as arviz-plots wants them, by the names of variables and by some coordinates."""
        from arviz_plots import PlotCollection

        figure = np.empty((), dtype=object)
        figure[()] = self.figure
        plots = {name: (list(coords), np.array(targets, dtype=object)) for name, targets in placed.items()}
        viz = {"/": xr.Dataset({"figure": ((), figure)}), "/plot": xr.Dataset(plots, coords)}
        return PlotCollection(data, xr.DataTree.from_dict(viz), aes=aes, backend=self.backend, **values)

    def drawn(self, collection):
        """What a function returns."""
        return self.targets if self.is_matplotlib else collection
