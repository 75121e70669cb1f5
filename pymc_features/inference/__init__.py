"""Around the sampling: identifiability, asymptotics, NUTS, and the choice of a tolerance."""

from pymc_features.inference.compiled import compiled_logp
from pymc_features.inference.fisher import fisher_information
from pymc_features.inference.laplace import laplace
from pymc_features.inference.nuts import sample_nuts
from pymc_features.inference.sample import sample
from pymc_features.inference.tolerance import tolerance_sweep

__all__ = [
    "compiled_logp",
    "fisher_information",
    "laplace",
    "sample",
    "sample_nuts",
    "tolerance_sweep",
]
