"""The priors, and what they expect of each sensor, with what was measured."""

import numpy as np

from pymc_features.plots.drawing.axes import broken, inches_of, set_title
from pymc_features.plots.drawing.envelope import columns_of, draw_band, draw_line, draw_measured

WIDTH, HEIGHT, OF_DENSITY = 9.0, 1.2, 1.6  # inches: of the figure, of a channel, of a prior
TOP, GAP, BOTTOM, LEFT, RIGHT = 0.7, 0.7, 0.55, 0.75, 0.15  # inches around them
IN_A_ROW = 4
WIDEST = 3.0  # height of an axis over that of the measurement, where bands are wide


def draw_expected(channels, bands, densities, units) -> np.ndarray:
    """Densities of the priors below the channels, each sensor on the band that is expected of it.

    Parameters
    ----------
    channels : DataArray (sensor, time)
        The base first, with its own units in the coordinate `units` where these differ.
    bands : array (3, sensor, time)
        Quantiles 5, 50 and 95 % of the responses, without the base.
    densities : dict
        Names of parameters to values (k,) and densities (k,).
    units : dict
        Names of parameters to their units.

    Returns
    -------
    array of matplotlib Axes
        Of the channels, then of the priors.
    """
    from matplotlib import pyplot

    n, rows = channels.sizes["sensor"], -(-len(densities) // IN_A_ROW)
    of_channels, of_densities = n * HEIGHT, rows * OF_DENSITY
    height = TOP + of_channels + (GAP + of_densities) * bool(rows) + BOTTOM
    figure = pyplot.figure(figsize=(WIDTH, height))
    # places are known, a layout engine would draw everything twice
    sides = {"left": LEFT / WIDTH, "right": 1.0 - RIGHT / WIDTH}
    top = 1.0 - TOP / height
    grid = figure.add_gridspec(n, 1, top=top, bottom=top - of_channels / height, hspace=0.45, **sides)
    axes = list(grid.subplots(sharex=True, squeeze=False)[:, 0])
    draw_channels(axes, channels, bands)
    if not rows:
        return np.array(axes)
    top = (BOTTOM + of_densities) / height
    sides["left"] = RIGHT / WIDTH
    grid = figure.add_gridspec(
        rows, IN_A_ROW, top=top, bottom=BOTTOM / height, hspace=0.6, wspace=0.08, **sides
    )
    for k, (name, (values, density)) in enumerate(densities.items()):
        ax = figure.add_subplot(grid[k // IN_A_ROW, k % IN_A_ROW])
        ax.fill_between(values, density, color="0.7", lw=0.0)
        unit = units.get(name, "").replace("^2", "²")
        label = f"{name} [{unit}], prior" if unit not in ("", "-") else f"{name}, prior"
        ax.set(xlabel=broken(label, inches_of(ax), "medium"), yticks=[], xlim=(values[0], values[-1]))
        ax.set_ylim(bottom=0.0)
        ax.xaxis.get_major_locator().set_params(nbins=4)
        axes.append(ax)
    return np.array(axes)


def draw_channels(axes, channels, bands) -> None:
    """Each channel on its axis."""
    time, whole = channels["time"].values, channels.attrs.get("units", "m/s^2")
    units = channels["units"].values.tolist() if "units" in channels.coords else [whole] * len(axes)
    columns = columns_of(axes[0], time, bands[1])
    named = zip(axes, channels["sensor"].values, channels.values, units, strict=True)
    for k, (ax, name, values, unit) in enumerate(named):
        text = f"{name}, peak {np.nanmax(np.abs(values)):.3g} {unit}".replace("^2", "²")
        if k:
            low, middle, high = bands[:, k - 1]
            known = ~np.isnan(values)
            inside = (values >= low) & (values <= high)
            draw_band(ax, time, low, high, columns, color="C0", alpha=0.35, label="priors, 5 to 95 %")
            draw_line(ax, time, middle, columns, color="C0", lw=0.8, label="priors, median")
            text += f": {100.0 * inside[known].mean():.0f} % of it within what the priors expect"
            least, most = np.nanmin(values), np.nanmax(values)
            room = 0.5 * (WIDEST - 1.0) * (most - least)
            ax.set_ylim(max(min(low.min(), least), least - room), min(max(high.max(), most), most + room))
        draw_measured(ax, time, values, columns)
        set_title(ax, text, loc="left", fontsize="medium")
        ax.margins(x=0.0)
        ax.set_ylabel(f"[{unit}]".replace("^2", "²"))
    axes[-1].set_xlabel("time [s]")
    handles, labels = axes[-1].get_legend_handles_labels()
    axes[0].figure.legend(handles, labels, loc="upper center", ncols=len(labels), frameon=False)
