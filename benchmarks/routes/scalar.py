"""Our kernel for one particle, called from Python for each."""

import numpy as np

from pymc_features.simulators import chain_discrepancy


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s)."""
    mass, rayleigh, ratios = case.mass, case.rayleigh, np.zeros(case.n_dof)
    rest = (
        case.acceleration,
        case.dt,
        case.substeps,
        1,
        case.sensors,
        case.n_dof,
        0,
        case.observed,
    )

    def evaluate():
        return np.array([chain_discrepancy(mass, k, rayleigh, ratios, *rest) for k in case.stiffness])

    return evaluate
