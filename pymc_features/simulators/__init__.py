"""Arrays in, arrays out: modes, the exact recursion, and the discrepancy, as compiled kernels."""

from pymc_features.simulators.chain.gradient import (
    discrepancy_tangent,
    misfit_gradient,
    population_gradient,
    response_gradient,
    response_tangent,
)
from pymc_features.simulators.chain.parameters import ChainParameters
from pymc_features.simulators.chain.population import population_discrepancy, population_misfit
from pymc_features.simulators.chain.response import chain_discrepancy, chain_misfit, chain_response
from pymc_features.simulators.families import FAMILIES
from pymc_features.simulators.oscillators.arguments import QUANTITIES, Excitation, Outputs, n_outputs
from pymc_features.simulators.quantities import HISTORIES, at_outputs, checked_request, force_share, rows_of
from pymc_features.simulators.request import UNITS, request
from pymc_features.simulators.simulate import simulate
from pymc_features.simulators.spring_forces import integration_error, spring_forces

__all__ = [
    "FAMILIES",
    "HISTORIES",
    "QUANTITIES",
    "ChainParameters",
    "Excitation",
    "Outputs",
    "UNITS",
    "at_outputs",
    "chain_discrepancy",
    "chain_misfit",
    "chain_response",
    "checked_request",
    "misfit_gradient",
    "discrepancy_tangent",
    "force_share",
    "integration_error",
    "n_outputs",
    "population_discrepancy",
    "population_gradient",
    "population_misfit",
    "request",
    "response_gradient",
    "response_tangent",
    "rows_of",
    "simulate",
    "spring_forces",
]
