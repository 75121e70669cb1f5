"""Kernels for `pm.sample_smc`, and results that can be saved. Nothing here knows of structures."""

from pymc_features.smc.evaluation import PopulationLogp, PopulationWarning
from pymc_features.smc.imh import PopulationIMH
from pymc_features.smc.mh import PopulationMH
from pymc_features.smc.relative_imh import RelativeIMH
from pymc_features.smc.results import savable

KERNELS = (PopulationIMH, PopulationMH)

__all__ = ["KERNELS", "PopulationIMH", "PopulationLogp", "PopulationMH", "PopulationWarning", "RelativeIMH", "savable"]
