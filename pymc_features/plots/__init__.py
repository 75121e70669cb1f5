"""Figures, each a function that takes a result and returns an array of axes.

A new one is one file and one line. matplotlib is imported when the first of them is drawn.
"""

from pymc_features.plots.channels import plot_channels as plot_channels
from pymc_features.plots.drawing.axes import close as close
from pymc_features.plots.draws import plot_chains as plot_chains
from pymc_features.plots.draws import plot_prior_posterior as plot_prior_posterior
from pymc_features.plots.events.placement import plot_sensor_placement as plot_sensor_placement
from pymc_features.plots.events.sequence import plot_sequence as plot_sequence
from pymc_features.plots.loops import plot_loops as plot_loops
from pymc_features.plots.modes.mac import plot_mac as plot_mac
from pymc_features.plots.modes.mode_shapes import plot_mode_shapes as plot_mode_shapes
from pymc_features.plots.modes.natural_frequencies import plot_natural_frequencies as plot_natural_frequencies
from pymc_features.plots.modes.singular_values import plot_singular_values as plot_singular_values
from pymc_features.plots.predictive import plot_predictive as plot_predictive
from pymc_features.plots.record import plot_record as plot_record
from pymc_features.plots.response_bands import plot_response_bands as plot_response_bands
from pymc_features.plots.study import plot_sampling_rate as plot_sampling_rate
from pymc_features.plots.study import plot_widths as plot_widths
from pymc_features.plots.tempering import plot_tempering as plot_tempering
from pymc_features.plots.tolerance import plot_tolerance as plot_tolerance

__all__ = [name for name in dir() if name.startswith("plot_")]
