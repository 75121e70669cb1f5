"""The PyTensor Ops of the package, and their Numba dispatch."""

from pymc_features.ops import numba_dispatch
from pymc_features.ops.base import N_PARAMETERS, NotDifferentiableError
from pymc_features.ops.discrepancy import ChainDiscrepancy, check_shape
from pymc_features.ops.mean_square import mean_square_discrepancy
from pymc_features.ops.population import PopulationDiscrepancy
from pymc_features.ops.response import ChainResponse, response, response_node, response_step

OPS = (ChainResponse, ChainDiscrepancy, PopulationDiscrepancy)

__all__ = [
    "N_PARAMETERS",
    "OPS",
    "ChainDiscrepancy",
    "ChainResponse",
    "NotDifferentiableError",
    "PopulationDiscrepancy",
    "check_shape",
    "mean_square_discrepancy",
    "numba_dispatch",
    "response",
    "response_node",
    "response_step",
]
