"""Kernels of linear structures M x" + C x' + K x = load: any matrices, dense or sparse, affine in theta.

Modes are found with LAPACK or ARPACK, once for each set of parameters; what runs over time is compiled.
"""

from pymc_features.simulators.linear.gradient import (
    linear_misfit_gradient,
    linear_population_gradient,
    linear_response_gradient,
)
from pymc_features.simulators.linear.population import linear_population_discrepancy, linear_population_misfit
from pymc_features.simulators.linear.response import linear_discrepancy, linear_misfit, linear_response
from pymc_features.simulators.linear.tangent import linear_discrepancy_tangent, linear_response_tangent

__all__ = [
    "linear_discrepancy",
    "linear_discrepancy_tangent",
    "linear_misfit",
    "linear_misfit_gradient",
    "linear_population_discrepancy",
    "linear_population_gradient",
    "linear_population_misfit",
    "linear_response",
    "linear_response_gradient",
    "linear_response_tangent",
]
