"""`pmf.sample`, where this version of the package has it."""

import pymc_features as pmf
from benchmarks.methods import NotThereError


def sample(model, seed):
    """Two chains, 1000 draws in all."""
    function = getattr(pmf, "sample", None)
    if function is None:
        raise NotThereError("pymc_features has no sample")
    return function(500, chains=2, model=model, random_seed=seed)
