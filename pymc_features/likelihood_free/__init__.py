"""Likelihood-free updating: the simulator node and its tolerance."""

from pymc_features.likelihood_free.simulator import DiscrepancySimulator
from pymc_features.likelihood_free.tolerance import abc_tolerance

__all__ = ["DiscrepancySimulator", "abc_tolerance"]
