"""Figures, each a function that takes a result and returns axes. A new one is one file and one line."""

from pymc_features.plots.chains import plot_chains
from pymc_features.plots.loops import plot_loops
from pymc_features.plots.natural_frequencies import plot_natural_frequencies
from pymc_features.plots.predictive import plot_predictive
from pymc_features.plots.prior_posterior import plot_prior_posterior
from pymc_features.plots.record import plot_record
from pymc_features.plots.response_bands import plot_response_bands
from pymc_features.plots.sampling_rate import plot_sampling_rate
from pymc_features.plots.tempering import plot_tempering
from pymc_features.plots.tolerance import plot_tolerance
from pymc_features.plots.widths import plot_widths

PLOTS = (
    plot_chains,
    plot_loops,
    plot_natural_frequencies,
    plot_predictive,
    plot_prior_posterior,
    plot_record,
    plot_response_bands,
    plot_sampling_rate,
    plot_tempering,
    plot_tolerance,
    plot_widths,
)

__all__ = [
    "PLOTS",
    "plot_chains",
    "plot_loops",
    "plot_natural_frequencies",
    "plot_predictive",
    "plot_prior_posterior",
    "plot_record",
    "plot_response_bands",
    "plot_sampling_rate",
    "plot_tempering",
    "plot_tolerance",
    "plot_widths",
]


def close(axes):
    """Release the figures of some axes."""
    from matplotlib import pyplot

    for ax in axes:
        pyplot.close(ax.figure)
