"""Likelihoods of response histories. A new one is one file here and one line below."""

from pymc_features.distributions import gaussian
from pymc_features.distributions.correlated import CorrelatedNormal
from pymc_features.distributions.exponential import ExpFeature, sigma_mpv
from pymc_features.distributions.gamma import GammaFeature
from pymc_features.distributions.truncnormal import TruncNormalFeature

FEATURE_LIKELIHOODS = (TruncNormalFeature, ExpFeature, GammaFeature)
LIKELIHOODS = (*FEATURE_LIKELIHOODS, CorrelatedNormal)  # of a history, one value for each sensor

__all__ = [
    "FEATURE_LIKELIHOODS",
    "LIKELIHOODS",
    "CorrelatedNormal",
    "ExpFeature",
    "GammaFeature",
    "TruncNormalFeature",
    "gaussian",
    "sigma_mpv",
]
