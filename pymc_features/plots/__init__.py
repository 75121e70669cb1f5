"""Figures, each a function that takes a result and returns axes. A new one is one file and one line."""

from pymc_features.plots.record import plot_record
from pymc_features.plots.sampling_rate import plot_sampling_rate

PLOTS = (plot_record, plot_sampling_rate)

__all__ = ["PLOTS", "plot_record", "plot_sampling_rate"]


def close(axes):
    """Release the figures of some axes."""
    from matplotlib import pyplot

    for ax in axes:
        pyplot.close(ax.figure)
