"""Figures, each a function that takes a result and returns an array of axes.

What is physics (records, responses, loops, modes, spectra) is drawn by matplotlib, which is imported when the
first of them is drawn; draws of a posterior by arviz-plots, in any of its backends.
"""

from pymc_features.plots.axes import close as close
from pymc_features.plots.curves import sampling_rate, sensor_placement, sequence, tempering, tolerance, widths
from pymc_features.plots.draws import chains, natural_frequencies, prior_posterior
from pymc_features.plots.histories import channels, predictive, record, response
from pymc_features.plots.hysteresis import loops
from pymc_features.plots.modes import mac, mode_shapes
from pymc_features.plots.spectra import response_functions, singular_values, stabilisation

__all__ = [
    "chains",
    "channels",
    "loops",
    "mac",
    "mode_shapes",
    "natural_frequencies",
    "predictive",
    "prior_posterior",
    "record",
    "response",
    "response_functions",
    "sampling_rate",
    "sensor_placement",
    "sequence",
    "singular_values",
    "stabilisation",
    "tempering",
    "tolerance",
    "widths",
]
__dir__ = __all__.copy
