"""Feature likelihoods. A new one is one file here and one line below."""

from pymc_features.distributions import gaussian
from pymc_features.distributions.checks import FeatureLikelihoodWarning
from pymc_features.distributions.exponential import ExpFeature, sigma_mpv
from pymc_features.distributions.truncnormal import TruncNormalFeature

FEATURE_LIKELIHOODS = (TruncNormalFeature, ExpFeature)

__all__ = [
    "FEATURE_LIKELIHOODS",
    "ExpFeature",
    "FeatureLikelihoodWarning",
    "TruncNormalFeature",
    "gaussian",
    "sigma_mpv",
]
