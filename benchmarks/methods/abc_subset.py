"""`SubsetSimulation` (ours) on `DiscrepancySimulator`, its defaults, one chain."""

import numpy as np

import pymc_features as pmf
from benchmarks.methods.pymc_smc import log_evidence, run_chain
from benchmarks.methods.result import Accepted


def method(problem, seed):
    """One run."""
    idata = run_chain(pmf.SubsetSimulation, problem.model, problem.draws, seed)
    simulations = int(np.nansum(idata["sample_stats"]["evaluations"].values))
    return Accepted(idata["posterior"]["theta"].values[0], simulations, log_evidence(idata))
