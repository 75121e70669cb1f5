"""Kernels for `pm.sample_smc`, and results that can be saved. Nothing here knows of structures."""

from pymc_features.smc.density.evaluation import PopulationLogp, PopulationWarning, population_logp
from pymc_features.smc.density.prior import prior_draws
from pymc_features.smc.kernels.base import PopulationKernel
from pymc_features.smc.kernels.checkpoint import CheckpointError
from pymc_features.smc.kernels.imh import PopulationIMH
from pymc_features.smc.kernels.levels import ToleranceNotReachedError
from pymc_features.smc.kernels.mh import PopulationMH
from pymc_features.smc.kernels.persistent import PersistentSMC
from pymc_features.smc.kernels.subset import SubsetSimulation, SubsetSimulationWarning
from pymc_features.smc.kernels.tmcmc import TMCMC
from pymc_features.smc.results import savable
from pymc_features.smc.sample import processors, sample_smc

KERNELS = (PopulationIMH, PopulationMH, PersistentSMC, TMCMC)  # for any model
SIMULATOR_KERNELS = (SubsetSimulation,)  # for models with one pm.Simulator node

__all__ = [
    "CheckpointError",
    "KERNELS",
    "SIMULATOR_KERNELS",
    "PersistentSMC",
    "PopulationIMH",
    "PopulationKernel",
    "PopulationLogp",
    "PopulationMH",
    "PopulationWarning",
    "SubsetSimulation",
    "SubsetSimulationWarning",
    "TMCMC",
    "ToleranceNotReachedError",
    "population_logp",
    "prior_draws",
    "processors",
    "sample_smc",
    "savable",
]
