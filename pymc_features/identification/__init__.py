"""Natural frequencies, damping and shapes from measured channels alone, with their uncertainty."""

from pymc_features.identification.identify import identify_modes
from pymc_features.identification.propose import propose_bands

__all__ = ["identify_modes", "propose_bands"]
