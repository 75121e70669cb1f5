"""What gradients are good for: identifiability before sampling, the asymptotic method, and NUTS."""

from pymc_features.inference.fisher import fisher_information
from pymc_features.inference.laplace import LaplaceWarning, laplace
from pymc_features.inference.nuts import ChainsDisagreeWarning, sample_nuts

__all__ = ["ChainsDisagreeWarning", "LaplaceWarning", "fisher_information", "laplace", "sample_nuts"]
