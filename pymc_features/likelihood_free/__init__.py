"""Likelihood-free updating: the simulator node and its tolerance."""

from pymc_features.likelihood_free.kernels import KERNELS
from pymc_features.likelihood_free.simulator import DiscrepancySimulator
from pymc_features.likelihood_free.tolerance import abc_tolerance

NODES = (DiscrepancySimulator,)

__all__ = ["KERNELS", "NODES", "DiscrepancySimulator", "abc_tolerance"]
