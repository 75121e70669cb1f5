"""The PyTensor Ops of the package, and their Numba dispatch."""

from pymc_features.ops import jax_loader, numba_dispatch
from pymc_features.ops.axes import by_labels, check_dims, known_dims, name_the_time_axis
from pymc_features.ops.comparison import (
    DiscrepancyTangent,
    MisfitGradient,
    StructuralDiscrepancy,
    StructuralMisfit,
    mean_square_discrepancy,
    measured_samples,
    misfit_statistics,
)
from pymc_features.ops.external import ExternalDiscrepancy, ExternalGradient, ExternalResponse
from pymc_features.ops.gradient import NoGradient, ResponseGradient, ResponseTangent
from pymc_features.ops.population import PopulationDiscrepancy, PopulationGradient, PopulationMisfit
from pymc_features.ops.response import (
    StructuralResponse,
    frequencies_behind,
    noisy_base,
    response,
    response_node,
    response_step,
    structural_node,
    was_simulated,
)
from pymc_features.ops.structural import check_shape
from pymc_features.structures.base import as_tensor

OPS = numba_dispatch.OPS

__all__ = [
    "OPS",
    "StructuralDiscrepancy",
    "MisfitGradient",
    "DiscrepancyTangent",
    "ExternalDiscrepancy",
    "ExternalGradient",
    "ExternalResponse",
    "StructuralMisfit",
    "StructuralResponse",
    "ResponseGradient",
    "ResponseTangent",
    "NoGradient",
    "PopulationDiscrepancy",
    "PopulationGradient",
    "PopulationMisfit",
    "as_tensor",
    "by_labels",
    "check_dims",
    "check_shape",
    "jax_loader",
    "known_dims",
    "mean_square_discrepancy",
    "measured_samples",
    "misfit_statistics",
    "name_the_time_axis",
    "frequencies_behind",
    "noisy_base",
    "numba_dispatch",
    "response",
    "response_node",
    "response_step",
    "structural_node",
    "was_simulated",
]
