"""Intervals whose width the residuals decide: neither the sampling rate nor the number of sensors does."""

from pymc_features.calibration.calibrate import calibrate, effective_samples, fill_degrees
from pymc_features.calibration.events import event_check

__all__ = ["calibrate", "effective_samples", "event_check", "fill_degrees"]
__dir__ = __all__.copy
