"""Arrays in, arrays out: modes, the exact recursion, and the discrepancy, as compiled kernels."""

from pymc_features.simulators.compilation import SOURCE_HASH
from pymc_features.simulators.discrepancy import chain_discrepancy, chain_misfit
from pymc_features.simulators.gradient import discrepancy_gradient, population_gradient, response_gradient
from pymc_features.simulators.histories import HISTORIES, has_response, modal_systems, response_blocks
from pymc_features.simulators.nonlinear_kernels import nonlinear_kernels
from pymc_features.simulators.population import population_discrepancy, population_misfit
from pymc_features.simulators.recursion import QUANTITIES, chain_response, n_outputs
from pymc_features.simulators.sampling import UNITS, request
from pymc_features.simulators.simulate import simulate
from pymc_features.simulators.springs import integration_error, spring_forces
from pymc_features.simulators.tangent import discrepancy_tangent, response_tangent

__all__ = [
    "HISTORIES",
    "QUANTITIES",
    "SOURCE_HASH",
    "UNITS",
    "chain_discrepancy",
    "chain_misfit",
    "chain_response",
    "discrepancy_gradient",
    "discrepancy_tangent",
    "has_response",
    "integration_error",
    "modal_systems",
    "n_outputs",
    "nonlinear_kernels",
    "population_discrepancy",
    "population_gradient",
    "population_misfit",
    "request",
    "response_blocks",
    "response_gradient",
    "response_tangent",
    "simulate",
    "spring_forces",
]
