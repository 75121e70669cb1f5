"""Kernels for `pm.sample_smc`, and results that can be saved. Nothing here knows of structures."""

from pymc_features.smc.density.evaluation import PopulationLogp, population_logp
from pymc_features.smc.density.graph import Outputs, batched_graph
from pymc_features.smc.density.prior import prior_points
from pymc_features.smc.density.rows import RowFunction
from pymc_features.smc.kernels.base import PopulationKernel
from pymc_features.smc.kernels.metropolis import TMCMC, PopulationIMH, PopulationMH
from pymc_features.smc.kernels.persistent import PersistentSMC
from pymc_features.smc.kernels.subset import SubsetSimulation
from pymc_features.smc.proposals.reference import Reference, find_reference
from pymc_features.smc.sample import check_run, likelihood_kinds, processors, sample_smc, savable
from pymc_features.smc.workers import Workers, check_workers, open_workers

KERNELS = (PopulationIMH, PopulationMH, PersistentSMC, TMCMC)  # for any model
SIMULATOR_KERNELS = (SubsetSimulation,)  # for models with one pm.Simulator node

__all__ = [
    "KERNELS",
    "SIMULATOR_KERNELS",
    "Outputs",
    "PersistentSMC",
    "PopulationIMH",
    "PopulationKernel",
    "PopulationLogp",
    "PopulationMH",
    "Reference",
    "RowFunction",
    "SubsetSimulation",
    "TMCMC",
    "Workers",
    "batched_graph",
    "check_run",
    "check_workers",
    "find_reference",
    "likelihood_kinds",
    "open_workers",
    "population_logp",
    "prior_points",
    "processors",
    "sample_smc",
    "savable",
]
