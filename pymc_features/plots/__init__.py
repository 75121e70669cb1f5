"""Figures, each a function that takes a result and returns an array of axes.

What is physics (records, responses, loops, modes, spectra) is drawn by matplotlib, which is imported when the
first of them is drawn; draws of a posterior by arviz-plots, in any of its backends.
"""

from pymc_features.plots.axes import close as close
from pymc_features.plots.curves import plot_sampling_rate as plot_sampling_rate
from pymc_features.plots.curves import plot_sensor_placement as plot_sensor_placement
from pymc_features.plots.curves import plot_sequence as plot_sequence
from pymc_features.plots.curves import plot_tempering as plot_tempering
from pymc_features.plots.curves import plot_tolerance as plot_tolerance
from pymc_features.plots.curves import plot_widths as plot_widths
from pymc_features.plots.draws import plot_chains as plot_chains
from pymc_features.plots.draws import plot_natural_frequencies as plot_natural_frequencies
from pymc_features.plots.draws import plot_prior_posterior as plot_prior_posterior
from pymc_features.plots.histories import plot_channels as plot_channels
from pymc_features.plots.histories import plot_predictive as plot_predictive
from pymc_features.plots.histories import plot_record as plot_record
from pymc_features.plots.histories import plot_response_bands as plot_response_bands
from pymc_features.plots.loops import plot_loops as plot_loops
from pymc_features.plots.modes import plot_mac as plot_mac
from pymc_features.plots.modes import plot_mode_shapes as plot_mode_shapes
from pymc_features.plots.spectra import plot_singular_values as plot_singular_values

__all__ = [name for name in dir() if name.startswith("plot_")]
