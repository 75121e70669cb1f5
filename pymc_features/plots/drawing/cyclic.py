"""Loops of a cyclic test: measured force against displacement, and the band of the posterior."""

import numpy as np

from pymc_features.plots.drawing.axes import checked_axes, set_title

PARTS = 3  # of a test, side by side: loops lie on loops


def draw_test(displacement, bands, measured, axes, label: str) -> np.ndarray:
    """Force against displacement in consecutive parts of a test.

    Parameters
    ----------
    displacement : array (time,)
        [m]
    bands : array (3, time)
        Lower edge, middle and upper edge of the force [N].
    measured : array (time,) or None
        Measured force [N].
    axes : matplotlib Axes, sequence of them, or None
    label : str
        Of the band.
    """
    from matplotlib.collections import PolyCollection

    axes = checked_axes(axes, PARTS, "parts of the test", columns=PARTS, figsize=(11.0, 3.8), sharey=True)
    scale, unit = scaled(np.abs(bands).max())
    edges = np.linspace(0, displacement.size - 1, PARTS + 1).astype(int)
    for ax, first, last in zip(axes, edges[:-1], edges[1:], strict=True):
        span = slice(first, last + 1)
        x, (low, middle, high) = 1e3 * displacement[span], bands[:, span] / scale
        band = PolyCollection(strips(x, low, high), facecolor="C0", alpha=0.35, lw=0.0, label=label)
        ax.add_collection(band)
        ax.plot(x, middle, color="C0", lw=1.0, label="median")
        if measured is not None:
            ax.plot(x, measured[span] / scale, color="0.15", lw=0.8, ls="--", label="measured")
        ax.set_xlabel("displacement [mm]")
        set_title(ax, f"samples {first} to {last}", fontsize="medium")
    axes[0].set_ylabel(f"force [{unit}]")
    axes[0].legend(frameon=False, fontsize="small")
    return axes


def scaled(largest: float) -> tuple[float, str]:
    """What forces are divided by, and their unit then."""
    return next(((f, unit) for f, unit in ((1e6, "MN"), (1e3, "kN")) if largest >= f), (1.0, "N"))


def strips(x, low, high) -> np.ndarray:
    """Corners (step, 4, 2) of what lies between two lines over each step of a path."""
    across = np.stack([x[:-1], x[1:], x[1:], x[:-1]], axis=1)
    return np.stack([across, np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)], axis=2)
