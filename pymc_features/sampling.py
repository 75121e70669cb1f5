"""Samplers of any PyMC model: posterior and evidence, approximations, and plain functions of its density."""

from pymc_features.inference import (
    compiled_logp,
    fisher_information,
    laplace,
    sample,
    sample_nuts,
    tolerance_sweep,
)
from pymc_features.smc import TMCMC, PersistentSMC, PopulationIMH, PopulationMH, SubsetSimulation, sample_smc

__all__ = [
    "PersistentSMC",
    "PopulationIMH",
    "PopulationMH",
    "SubsetSimulation",
    "TMCMC",
    "compiled_logp",
    "fisher_information",
    "laplace",
    "sample",
    "sample_nuts",
    "sample_smc",
    "tolerance_sweep",
]
__dir__ = __all__.copy
