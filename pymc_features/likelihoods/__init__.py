"""Likelihoods of response histories, likelihood-free nodes, and the catalogue of both."""

from pymc_features.likelihoods import gaussian
from pymc_features.likelihoods.abc import KERNELS, DiscrepancySimulator, abc_tolerance
from pymc_features.likelihoods.catalogue import DIMS, LIKELIHOODS, Comparison, Likelihood
from pymc_features.likelihoods.correlated import CorrelatedNormal
from pymc_features.likelihoods.mean_square import (
    ExpFeature,
    GammaFeature,
    TruncNormalFeature,
    sigma_mpv,
)

FEATURE_LIKELIHOODS = (TruncNormalFeature, ExpFeature, GammaFeature)
HISTORY_LIKELIHOODS = (*FEATURE_LIKELIHOODS, CorrelatedNormal)  # one value for each sensor
NODES = (DiscrepancySimulator,)

__all__ = [
    "DIMS",
    "FEATURE_LIKELIHOODS",
    "HISTORY_LIKELIHOODS",
    "KERNELS",
    "LIKELIHOODS",
    "NODES",
    "Comparison",
    "CorrelatedNormal",
    "DiscrepancySimulator",
    "ExpFeature",
    "GammaFeature",
    "Likelihood",
    "TruncNormalFeature",
    "abc_tolerance",
    "gaussian",
    "sigma_mpv",
]
__dir__ = __all__.copy
