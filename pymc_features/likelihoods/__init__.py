"""Ways to compare response and measurements. A new one is one file here and one entry below.

The study, `update` with its file and report, and the figures take everything they know of a likelihood from
its entry: how it is declared, what it means, which parameters it takes, its colour and its exact posterior.
"""

from pymc_features.likelihoods.calibrated import CAL
from pymc_features.likelihoods.correlated import CN, CN_SIGMA, CN_TAU
from pymc_features.likelihoods.exponential import EXP
from pymc_features.likelihoods.free import ABC
from pymc_features.likelihoods.gamma import GAMMA
from pymc_features.likelihoods.independent import NORM
from pymc_features.likelihoods.likelihood import DIMS, Comparison, Likelihood
from pymc_features.likelihoods.truncnormal import TN

#: By name. The place of a likelihood is part of its seed: new ones go to the end.
LIKELIHOODS = {entry.name: entry for entry in (NORM, TN, EXP, ABC, CN, CN_SIGMA, CN_TAU, GAMMA, CAL)}
#: Names of those that the study can judge by their exact posteriors.
WITH_REFERENCE = tuple(name for name, entry in LIKELIHOODS.items() if entry.has_reference)

__all__ = ["DIMS", "LIKELIHOODS", "WITH_REFERENCE", "Comparison", "Likelihood"]
