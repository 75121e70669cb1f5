"""The PyTensor Ops of the package, and their Numba dispatch."""

from pymc_features.ops import numba_dispatch
from pymc_features.ops.base import NotDifferentiableError
from pymc_features.ops.discrepancy import ChainDiscrepancy, check_shape, mean_square_discrepancy
from pymc_features.ops.response import ChainResponse, response, response_node, response_step

OPS = (ChainResponse, ChainDiscrepancy)

__all__ = [
    "OPS",
    "ChainDiscrepancy",
    "ChainResponse",
    "NotDifferentiableError",
    "check_shape",
    "mean_square_discrepancy",
    "numba_dispatch",
    "response",
    "response_node",
    "response_step",
]
