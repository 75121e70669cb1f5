"""Derivatives of response and discrepancy of linear structures along a direction: `gradient` transposed.

The parameters of all functions are those of `Arguments`, in their order, and what else is said, at the end
the directions of theta (p,), rayleigh (2,) and ratios (k,).
"""

import numpy as np

from pymc_features.simulators.linear import oscillators, state_adjoint
from pymc_features.simulators.linear.arguments import N_PARAMETERS, Arguments
from pymc_features.simulators.linear.projection import move
from pymc_features.simulators.linear.system import solve_system
from pymc_features.simulators.oscillators.blocks import destination


def linear_response_tangent(parameters, excitation, wanted, directions) -> np.ndarray:
    """Derivative (s, u) of the response along a direction; NaN where there is no structure."""
    a = Arguments(*parameters, *excitation, *wanted)
    a.check()
    return tangent(a, directions, None)


def linear_discrepancy_tangent(parameters, excitation, wanted, observed, directions) -> np.ndarray:
    """Derivative (s,) of e_j along a direction; data (s, u) and the direction follow the arguments."""
    a = Arguments(*parameters, *excitation, *wanted)
    a.check(observed)
    return tangent(a, directions, observed)


def tangent(a, directions, observed):
    """Derivative of the response or, with data, of the discrepancies."""
    if any(d.shape != array.shape for d, array in zip(directions, a[:N_PARAMETERS], strict=True)):
        raise ValueError("the directions must have the shapes of the parameters")
    n_sensors, total = a.shape
    system = solve_system(a, left_out=True)
    if system is None:
        return np.full((n_sensors, total) if observed is None else n_sensors, np.nan)
    observed, history, sums = destination(a.shape, observed)
    d_theta, *others = directions
    route = oscillators if a.is_classical else state_adjoint
    route.push_forward(a, system, move(a, system, d_theta), *others, observed, history, sums[0])
    return history if history.size else sums[0] / total
