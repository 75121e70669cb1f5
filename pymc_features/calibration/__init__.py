"""Intervals whose width the residuals decide: neither the sampling rate nor the number of sensors does."""

from pymc_features.calibration.effective import effective_samples

__all__ = ["effective_samples"]
