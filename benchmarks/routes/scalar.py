"""Our kernel for one particle, called from Python for each."""

import numpy as np

from pymc_features.simulators import ChainParameters, chain_discrepancy


def prepare(case):
    """Return a call that evaluates the population of `case`, shape (P, s)."""
    damping, rest = (case.rayleigh, np.zeros(case.n_dof)), (*case.settings, case.observed)
    chains = [ChainParameters(case.mass, k, *damping) for k in case.stiffness]
    return lambda: np.array([chain_discrepancy(chain, *rest) for chain in chains])
