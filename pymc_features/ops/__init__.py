"""The PyTensor Ops of the package, and their Numba dispatch."""

from pymc_features.ops import jax_loader, numba_dispatch
from pymc_features.ops.base import N_PARAMETERS
from pymc_features.ops.discrepancy import ChainDiscrepancy, check_shape
from pymc_features.ops.gradient import (
    ChainDiscrepancyGradient,
    ChainDiscrepancyTangent,
    ChainResponseGradient,
    ChainResponseTangent,
    PopulationGradient,
)
from pymc_features.ops.mean_square import mean_square_discrepancy, misfit_statistics
from pymc_features.ops.misfit import ChainMisfit
from pymc_features.ops.no_gradient import NoGradient, NotDifferentiableError
from pymc_features.ops.population import PopulationDiscrepancy, PopulationMisfit
from pymc_features.ops.response import ChainResponse, response, response_node, response_step
from pymc_features.ops.time_axis import name_the_time_axis

OPS = (
    ChainResponse,
    ChainDiscrepancy,
    PopulationDiscrepancy,
    ChainMisfit,
    PopulationMisfit,
    ChainResponseGradient,
    ChainResponseTangent,
    ChainDiscrepancyGradient,
    ChainDiscrepancyTangent,
    PopulationGradient,
)

__all__ = [
    "N_PARAMETERS",
    "OPS",
    "ChainDiscrepancy",
    "ChainDiscrepancyGradient",
    "ChainDiscrepancyTangent",
    "ChainMisfit",
    "ChainResponse",
    "ChainResponseGradient",
    "ChainResponseTangent",
    "NoGradient",
    "NotDifferentiableError",
    "PopulationDiscrepancy",
    "PopulationGradient",
    "PopulationMisfit",
    "check_shape",
    "jax_loader",
    "mean_square_discrepancy",
    "misfit_statistics",
    "name_the_time_axis",
    "numba_dispatch",
    "response",
    "response_node",
    "response_step",
]
