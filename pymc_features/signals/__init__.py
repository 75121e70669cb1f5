"""Processing and checks of measured channels, `xarray` arrays (sensor, time) as `read_channels` returns them.

    window = pmf.signals.trim(channels, 18.0, 48.0)
    still = pmf.signals.detrend(window, window=(0.0, 2.0))
    clean = pmf.signals.band_pass(still, low=0.2, high=40.0)
    slower = pmf.signals.decimate(clean, 2)

Each function returns a new array, and treats all channels alike, so that their ratios stay what they were.
"""

from pymc_features.signals.channels import band_pass, correct, decimate, detrend, sampling_step, trim
from pymc_features.signals.check import check_channels
from pymc_features.signals.frequency_response import frequency_response
from pymc_features.signals.spectra import low_frequency_gains

__all__ = [
    "band_pass",
    "check_channels",
    "correct",
    "decimate",
    "detrend",
    "frequency_response",
    "low_frequency_gains",
    "sampling_step",
    "trim",
]
__dir__ = __all__.copy
