"""Derivatives of response and discrepancy of linear structures along a direction: `gradient` transposed.

All functions take a `LinearParameters`, an `Excitation` and the `Outputs` wanted, and at the end a tuple of
the directions of theta (p,), rayleigh (2,) and ratios (k,).
"""

import numpy as np

from pymc_features.simulators.linear import oscillators, state_adjoint
from pymc_features.simulators.linear.arguments import Arguments
from pymc_features.simulators.linear.projection import project_direction
from pymc_features.simulators.linear.response import data_or_history
from pymc_features.simulators.linear.system import solved_alone


def linear_response_tangent(parameters, excitation, wanted, directions) -> np.ndarray:
    """Derivative (s, u) of the response along a direction; NaN where there is no structure."""
    a = Arguments(parameters, excitation, wanted)
    a.check()
    return tangent(a, directions, None)


def linear_discrepancy_tangent(parameters, excitation, wanted, observed, directions) -> np.ndarray:
    """Derivative (s,) of e_j along a direction; data (s, u)."""
    a = Arguments(parameters, excitation, wanted)
    a.check(observed)
    return tangent(a, directions, observed)


def tangent(a, directions, observed):
    """Derivative of the response or, with data, of the discrepancies."""
    if any(d.shape != array.shape for d, array in zip(directions, a.parameters.random, strict=True)):
        raise ValueError("the directions must have the shapes of the parameters")
    n_sensors, total = a.shape
    a, system = solved_alone(a, left_out=True)
    if system is None:
        return np.full((n_sensors, total) if observed is None else n_sensors, np.nan)
    observed, history = data_or_history(a, observed)
    change = project_direction(a, system, directions[0])
    route = oscillators if a.parameters.is_classical else state_adjoint
    sums = route.push_forward(a, system, change, directions[1:], observed, history)
    return history if history.size else sums / total
