"""Around the sampling: identifiability, asymptotics, NUTS, the choice of a tolerance, and prediction."""

from pymc_features.inference.draws import PredictionWarning
from pymc_features.inference.first_passage import first_passage_probability
from pymc_features.inference.fisher import fisher_information
from pymc_features.inference.laplace import LaplaceWarning, laplace
from pymc_features.inference.nuts import ChainsDisagreeWarning, sample_nuts
from pymc_features.inference.prediction import posterior_response
from pymc_features.inference.tolerance import tolerance_sweep

__all__ = [
    "ChainsDisagreeWarning",
    "LaplaceWarning",
    "PredictionWarning",
    "first_passage_probability",
    "fisher_information",
    "laplace",
    "posterior_response",
    "sample_nuts",
    "tolerance_sweep",
]
